"""The landing model of a goal-shift controller as an ONNX graph, for batches of any length.

Inputs ``goal`` (n, 3; m, m, rad), ``stance`` (n, 1; rad), ``since`` (n, 20), what a sudden change has added to the
deviation from the plan now and at the update before, ``update`` (n,) and ``age`` (n,), the updates since the change,
from 1 on; output ``landing`` (n, 3), if the goal stays what it is. Double precision. What the model is for stands in
the metadata, as JSON under ``leapgap``.
"""

import json
from collections.abc import Mapping

import numpy as np
import onnx
from onnx import TensorProto, helper

from leapgap.jumping.learning.onnx_graph import IR_VERSION, OPSET, Graph


def serialise(tables: Mapping[str, np.ndarray], about: Mapping[str, object]) -> bytes:
    """The graph of the tables (``leapgap.jumping.export.tables``); equal tables, equal bytes."""
    graph = Graph()

    def constant(values: object) -> str:
        return graph.constant(np.asarray(values))

    axis, middle, double = constant([1]), constant([2]), np.float64
    at = graph.node("Concat", "goal", "stance", axis=1)
    scaled = graph.node("Div", at, constant(tables["landing_scale"]))
    samples = tables["landing_sample"]
    apart = graph.node("Sub", graph.node("Unsqueeze", scaled, axis), constant(samples[None]))
    squared = graph.node("ReduceSumSquare", apart, middle, keepdims=0)
    near = graph.node("Exp", graph.node("Mul", squared, constant(double(-0.5))))
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
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "landing",
            [
                helper.make_tensor_value_info("goal", TensorProto.DOUBLE, ["n", 3]),
                helper.make_tensor_value_info("stance", TensorProto.DOUBLE, ["n", 1]),
                helper.make_tensor_value_info("since", TensorProto.DOUBLE, ["n", 20]),
                helper.make_tensor_value_info("update", TensorProto.INT64, ["n"]),
                helper.make_tensor_value_info("age", TensorProto.INT64, ["n"]),
            ],
            [helper.make_tensor_value_info("landing", TensorProto.DOUBLE, ["n", 3])],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="leapgap",
    )
    helper.set_model_props(model, {"leapgap": json.dumps(dict(about), sort_keys=True)})
    onnx.checker.check_model(model)
    return model.SerializeToString(deterministic=True)
