"""A flattened model as an ONNX graph, for whoever reads no NumPy: batches of any length, both phases.

Inputs as in ``Situation`` and ``contact`` (bool); outputs ``bias`` (n, 3) and ``by_force`` (n, 3, 4). Perceptrons
run in single precision, kernels in double. What the model is for stands in the metadata, as JSON under ``leapgap``.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from leapgap.jumping.learning.model import FlatPhase, Part

OPSET = 18
IR_VERSION = 10
INPUTS = {"state": 6, "foot": 4, "time_s": None, "start": 6}


class Graph:
    """Nodes and constants, named in the order they are added."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, value: np.ndarray) -> str:
        """Add a constant; its name in the graph."""
        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def node(self, kind: str, *inputs: str, out: str | None = None, **attributes: Any) -> str:
        """Add a node; the name of its output."""
        out = out or f"value_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [out], **attributes))
        return out


def serialise(phases: Mapping[str, FlatPhase], about: Mapping[str, object], known_size: int) -> bytes:
    """The model's bytes; the same model gives the same."""
    graph = Graph()
    time = graph.node("Unsqueeze", "time_s", graph.constant(np.array([1])))
    raw = graph.node("Concat", "state", "start", "foot", time, axis=1)
    relative = np.eye(known_size)  # x from the start of the prediction
    relative[6, 0], relative[6, 6] = -1.0, 0.0
    known = graph.node("MatMul", raw, graph.constant(relative))
    feet = graph.node("Identity", "foot")
    by_phase = [add_phase(graph, phases[phase], known, feet) for phase in ("contact", "flight")]
    contact = graph.node("Unsqueeze", "contact", graph.constant(np.array([1])))
    both = graph.node("Where", contact, *by_phase)
    bounds = [graph.constant(np.array([value])) for value in (0, 3, 15, 1)]
    graph.node("Slice", both, bounds[0], bounds[1], bounds[3], out="bias")
    flat = graph.node("Slice", both, bounds[1], bounds[2], bounds[3])
    graph.node("Reshape", flat, graph.constant(np.array([-1, 3, 4])), out="by_force")
    inputs = {name: (TensorProto.DOUBLE, *([] if size is None else [size])) for name, size in INPUTS.items()}
    outputs = {"bias": (TensorProto.DOUBLE, 3), "by_force": (TensorProto.DOUBLE, 3, 4)}
    return finished(graph, "leapgap", inputs | {"contact": (TensorProto.BOOL,)}, outputs, about)


def finished(
    graph: Graph, name: str, inputs: Mapping[str, Any], outputs: Mapping[str, Any], about: Mapping[str, object]
) -> bytes:
    """The bytes of a graph of batches, with type and further axes of its inputs and outputs."""
    ends = [
        [helper.make_tensor_value_info(key, kind, ["n", *axes]) for key, (kind, *axes) in of.items()]
        for of in (inputs, outputs)
    ]
    model = helper.make_model(
        helper.make_graph(graph.nodes, name, *ends, graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="leapgap",
    )
    helper.set_model_props(model, {"leapgap": json.dumps(dict(about), sort_keys=True)})
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString(deterministic=True))


def add_phase(graph: Graph, phase: FlatPhase, known: str, feet: str) -> str:
    """Add one phase to the graph: constant + feet · foot + Σ parts, (n, 15)."""
    add = {"perceptron": add_perceptron, "kernel": add_kernel}
    total = graph.node("Add", graph.node("MatMul", feet, graph.constant(phase.feet)), graph.constant(phase.constant))
    for part in phase.parts:
        total = graph.node("Add", total, add[part.kind](graph, part, known))
    return total


def add_perceptron(graph: Graph, part: Part, known: str) -> str:
    """Add a perceptron with tanh between its layers, (n, 15); ``known`` is (n, inputs)."""
    hidden, layers = graph.node("Cast", known, to=TensorProto.FLOAT), len(part.arrays) // 2
    for i in range(layers):
        weight, bias = (graph.constant(part.arrays[f"{kind}_{i}"]) for kind in ("weight", "bias"))
        hidden = graph.node("Add", graph.node("MatMul", hidden, weight), bias)
        if i < layers - 1:
            hidden = graph.node("Tanh", hidden)
    return graph.node("Cast", hidden, to=TensorProto.DOUBLE)


def add_kernel(graph: Graph, part: Part, known: str) -> str:
    """Add a kernel, (n, 15): Σ exp(−‖s − c‖²/2) coefficients = exp(s·c − ‖s‖²/2 − ‖c‖²/2) coefficients."""
    select, shift, centres = (part.arrays[name] for name in ("select", "shift", "centres"))
    at = graph.node("Sub", graph.node("MatMul", known, graph.constant(select)), graph.constant(shift))
    mine = graph.node("ReduceSumSquare", at, graph.constant(np.array([1])), keepdims=1)
    half = graph.node("Mul", graph.node("Add", mine, graph.constant((centres**2).sum(axis=1))), graph.constant(HALF))
    exponent = graph.node("Sub", graph.node("MatMul", at, graph.constant(centres.T)), half)
    return graph.node("MatMul", graph.node("Exp", exponent), graph.constant(part.arrays["coefficients"]))


HALF = np.array([0.5])


def serialise_landing(tables: Mapping[str, np.ndarray], about: Mapping[str, object]) -> bytes:
    """The graph of the tables (``leapgap.jumping.export.tables``); equal tables, equal bytes."""
    graph = Graph()

    def constant(values: object) -> str:
        return graph.constant(np.asarray(values))

    axis, middle = constant([1]), constant([2])
    at = graph.node("Concat", "goal", "stance", axis=1)
    scaled = graph.node("Div", at, constant(tables["landing_scale"]))
    samples = tables["landing_sample"]
    apart = graph.node("Sub", graph.node("Unsqueeze", scaled, axis), constant(samples[None]))
    squared = graph.node("ReduceSumSquare", apart, middle, keepdims=0)
    near = graph.node("Exp", graph.node("Mul", squared, constant(np.float64(-0.5))))
    trend = tables["landing_trend"]
    landing = graph.node("Add", graph.node("MatMul", at, constant(trend[1:] + np.eye(4)[:, :3])), constant(trend[0]))
    landing = graph.node("Add", landing, graph.node("MatMul", near, constant(tables["landing_dual"])))
    weights = tables["by_change"]
    ages = constant(np.int64(weights.shape[1]))
    later = graph.node("Min", graph.node("Sub", "age", constant(np.int64(1))), constant(np.int64(1)))
    at_age = graph.node("Add", graph.node("Mul", "update", ages), later)
    own = graph.node("Gather", constant(weights.reshape(-1, *weights.shape[2:])), at_age, axis=0)
    change = graph.node("Squeeze", graph.node("MatMul", graph.node("Unsqueeze", "since", axis), own), axis)
    graph.node("Add", landing, change, out="landing")
    double, number = TensorProto.DOUBLE, TensorProto.INT64
    inputs = {"goal": (double, 3), "stance": (double, 1), "since": (double, 20), "update": (number,), "age": (number,)}
    return finished(graph, "landing", inputs, {"landing": (double, 3)}, about)
