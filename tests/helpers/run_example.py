"""Run an example, check its result with the CAD kernel and print one line of JSON; test_examples.py runs this file."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any


def main(path: Path, ask: dict[str, str], **host: dict[str, Any]) -> dict[str, Any]:
    """Return the faults of the example's solid, its volume in mm^3, and the requested values.

    Args:
        path: The example.
        ask: Names and expressions, which are evaluated in the example's namespace.
        host: If given, CadQuery's CQGI builds the example with ``parameters``, after an attempt with ``refused``.
    """
    answer: dict[str, Any] = {}
    names = _hosted(path, answer, **host) if host else runpy.run_path(str(path))
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    from tacbench_cad.checks.solidcheck import solid_checks

    result = names["result"]
    shape = result.val() if hasattr(result, "val") else result
    shape = getattr(shape, "wrapped", shape)
    props = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, props, 1e-5, False, True)
    answer["faults"] = [f"{check.name}: {check.detail}" for check in solid_checks(shape) if not check.ok]
    answer["volume"] = props.Mass()
    space = {"pi": 3.141592653589793, **names}
    values = {name: eval(text, space) for name, text in ask.items()}
    # JSON cannot store NumPy's bool.
    return answer | {
        "values": {name: getattr(value, "item", lambda value=value: value)() for name, value in values.items()}
    }


def _hosted(path: Path, answer: dict[str, Any], parameters: dict[str, Any], refused: dict[str, Any]) -> dict[str, Any]:
    from cadquery import cqgi

    text = path.read_text(encoding="utf-8")
    built = cqgi.parse(text).build(refused)
    answer["refused"] = f"{type(built.exception).__name__}: {built.exception}"
    model = cqgi.parse(text)
    built = model.build(parameters)
    if not built.success:
        raise built.exception
    answer["parameters"] = list(model.metadata.parameters)
    answer["shown"] = [shown.options["name"] for shown in built.results]
    return {**built.env, "result": built.first_result.shape}


if __name__ == "__main__":
    print("\n" + json.dumps(main(Path(sys.argv[1]), **json.loads(sys.argv[2]))))
