"""What was sent to the motors: torques, gains of a joint PD, and commands that no column holds."""

from collections.abc import Iterable

import numpy as np

from leapgap.logs.importers.table_format import UNKNOWN
from leapgap.logs.map_proposal.joint_units import some_rows
from leapgap.logs.map_proposal.physics import CLEAR, correlations, factors, fit_gains
from leapgap.logs.map_proposal.proposal import ABSENT, ASKED, GUESSED, MISSING, SURE, Evidence, Proposal
from leapgap.robot.model import Robot
from leapgap.robot.stated_servos import servo_gains

SAME_TORQUE = 0.3
"""Measured over sent torque may depart from 1 by this much: motors are weak, currents are poor torque sensors."""
TOO_STRONG = 5.0
"""Torques that are most of the time so many times those that a motor of the model can give are of another unit."""


def judge_torques(evidence: Evidence, proposal: Proposal) -> None:
    """Whether the measured torque is the one sent, or that of a joint PD, whose gains are then estimated."""
    judge_size("tau", evidence, proposal)
    judge_size("cmd_tau", evidence, proposal)
    have = evidence.values.keys()
    if "tau" not in have or evidence.time is None:
        return
    if "cmd_tau" in have:
        _, sent, torque = some_rows(evidence, "cmd_tau", "tau")
        slope = factors(torque, sent)
        found = np.nan_to_num(np.diag(correlations(sent, torque)))
        clear = np.abs(found) > CLEAR
        if clear.any():
            ratio = float(np.median(slope[clear]))
            kind = SURE if abs(ratio - 1) < SAME_TORQUE else MISSING
            advice = "" if kind == SURE else ": check unit and sign of one of them"
            proposal.say(kind, f"the measured torque is {ratio:.3g} times the one that was sent{advice}")
            moved = np.ptp(sent, axis=0) > 0
            if kind == SURE and clear[moved].all():
                evidence.torque_alone = True
                return
    if {"cmd_pos", "joint_pos", "joint_vel"} <= have and not {"cmd_kp", "cmd_kd"} <= have:
        estimate_gains(evidence, proposal)


def judge_size(quantity: str, evidence: Evidence, proposal: Proposal) -> None:
    """Whether motors of the model can give such torques; else measured ones are left out, sent ones asked about.

    So are measured ones that nobody measured: a message has a place for them, and drivers leave it 0.
    """
    if quantity not in evidence.values:
        return
    if quantity == "tau" and not np.nan_to_num(evidence.values["tau"]).any():
        proposal.drop("tau")
        proposal.say(ABSENT, "measured torques: left out, they are 0 in all samples")
        del evidence.values["tau"]
        return
    limit, usual = evidence.robot.torque_limits, np.nanmedian(np.abs(evidence.values[quantity]), axis=0)
    times = float(np.max(np.where(np.isfinite(limit) & (limit > 0), usual / np.maximum(limit, 1e-9), 0.0)))
    if times < TOO_STRONG:
        return
    says = f"{quantity} is mostly {times:.3g} times what the motors of the model can give"
    if quantity == "tau":
        proposal.drop("tau")
        proposal.say(ABSENT, f"measured torques: left out, {says}; state units.tau/* (mNm, Ncm, …) or factors")
    else:
        proposal.put("units", "cmd_tau/*", ASKED)
        proposal.say(MISSING, f"the unit of the torques that were sent: {says}; state units.cmd_tau/* or factors")
    del evidence.values[quantity]
    evidence.unplaced.add(quantity)


def estimate_gains(evidence: Evidence, proposal: Proposal) -> None:
    """Gains of the joint PD from the measured torque."""
    names = ("tau", "cmd_pos", "joint_pos", "joint_vel", "cmd_vel", "cmd_tau")
    quantities = [name for name in names if name in evidence.values]
    at = dict(zip(quantities, some_rows(evidence, *quantities)[1:], strict=True))
    error, rate_error = at["cmd_pos"] - at["joint_pos"], at.get("cmd_vel", 0.0) - at["joint_vel"]
    sent = at["cmd_tau"].T if "cmd_tau" in at else [None] * len(evidence.robot.joints)
    fits = [fit_gains(*of_joint) for of_joint in zip(at["tau"].T, error.T, rate_error.T, sent, strict=True)]
    driven = evidence.robot.driven
    good = [one.explained > CLEAR and one.kp > 0 for one in fits] | ~driven
    if not all(good):
        weak = ", ".join(joint for joint, one in zip(evidence.robot.joints, good, strict=True) if not one)
        proposal.say(
            MISSING, f"gains of the joint PD: undetermined by the measured torque for {weak}; state cmd_kp, cmd_kd"
        )
        return
    for name, values in (("cmd_kp", [one.kp for one in fits]), ("cmd_kd", [max(0.0, one.kd) for one in fits])):
        proposal.put("constants", f"{name}/*", [float(f"{on * x:.3g}") for x, on in zip(values, driven, strict=True)])
    worst = min(one.explained for one, on in zip(fits, driven, strict=True) if on)
    proposal.say(
        GUESSED, f"gains of the joint PD by least squares: they explain {worst:.0%} or more of the measured torque"
    )


def fill_commands(evidence: Evidence, proposal: Proposal) -> None:
    """Commands that no column holds: zero where that is the only sense, else missing."""
    have = set(evidence.values)
    stated = {key.partition("/")[0] for key in proposal.options.get("constants", {})}
    if evidence.unplaced & {"cmd_pos", "cmd_vel", "cmd_tau"}:
        return
    if not have & {"cmd_pos", "cmd_vel", "cmd_tau"}:
        proposal.say(MISSING, "commands: no column looks like torques or set points that were sent")
        return
    if evidence.torque_alone:
        for quantity in ("cmd_pos", "cmd_vel"):  # references of a controller outside, which no motor follows
            proposal.drop(quantity)
        have -= {"cmd_pos", "cmd_vel"}
        why = "the torque that was sent is the measured one: no joint PD acts"
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, proposal, why)
        return
    if "cmd_pos" not in have:
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, proposal, "torques alone are sent, no joint PD")
        return
    zero(("cmd_tau",), have | stated, proposal, "set points alone are sent, no feed-forward torque")
    zero(("cmd_vel",), have | stated, proposal, "the joint PD damps towards rest")
    lacking = [name for name in ("cmd_kp", "cmd_kd") if name not in have | stated]
    if len(lacking) == 2 and take_gains_of_servos(evidence.robot, proposal):
        return
    if lacking and not any("gains" in sentence for sentence in proposal.notes_of(MISSING)):
        proposal.say(MISSING, f"gains of the joint PD: state constants.{'/*, constants.'.join(lacking)}/*")


def take_gains_of_servos(robot: Robot, proposal: Proposal) -> bool:
    """Take the gains of the model file's position servos as a start, if it has such, and say that they are unknown."""
    if servo_gains(robot) is None:
        return False
    proposal.options["gains"] = UNKNOWN
    proposal.notes = [one for one in proposal.notes if not (one[0] == MISSING and "gains" in one[1])]
    proposal.say(
        GUESSED,
        "gains of the joint PD are unknown; those of the servos in the model file are a first guess. If known, state "
        "constants.cmd_kp/* and cmd_kd/* (N·m/rad, N·m·s/rad) in place of gains: unknown",
    )
    return True


def zero(quantities: Iterable[str], have: set[str], proposal: Proposal, why: str) -> None:
    """Zero constants for quantities that are not there."""
    added = [name for name in quantities if name not in have]
    for name in added:
        proposal.put("constants", f"{name}/*", 0.0)
    if added:
        proposal.say(GUESSED, f"{', '.join(added)}: 0, since {why}")
