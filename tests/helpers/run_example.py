"""Run in a child process by test_examples.py: one example, its result examined by the kernel, as one line of JSON."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any


def main(path: Path, ask: dict[str, str], **host: dict[str, Any]) -> dict[str, Any]:
    """The example's answer: what is wrong with its solid, the volume in mm^3, and the values asked for.

    Args:
        path: The example.
        ask: Names and expressions, taken in the example's own namespace.
        host: With ``parameters`` it is built by CadQuery's CQGI with these; ``refused`` are tried before.
    """
    found: dict[str, Any] = {}
    names = _hosted(path, found, **host) if host else runpy.run_path(str(path))
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    from tacbench_cad.checks.solidcheck import solid_checks

    result = names["result"]
    shape = result.val() if hasattr(result, "val") else result
    shape = getattr(shape, "wrapped", shape)
    props = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, props, 1e-5, False, True)
    found["faults"] = [f"{one.name}: {one.detail}" for one in solid_checks(shape) if not one.ok]
    found["volume"] = props.Mass()
    space = {"pi": 3.141592653589793, **names}
    values = {name: eval(text, space) for name, text in ask.items()}
    # NumPy's bool is none of JSON's.
    return found | {
        "values": {name: getattr(value, "item", lambda value=value: value)() for name, value in values.items()}
    }


def _hosted(path: Path, found: dict[str, Any], parameters: dict[str, Any], refused: dict[str, Any]) -> dict[str, Any]:
    from cadquery import cqgi

    text = path.read_text(encoding="utf-8")
    built = cqgi.parse(text).build(refused)
    found["refused"] = f"{type(built.exception).__name__}: {built.exception}"
    model = cqgi.parse(text)
    built = model.build(parameters)
    if not built.success:
        raise built.exception
    found["parameters"] = list(model.metadata.parameters)
    found["shown"] = [one.options["name"] for one in built.results]
    return {**built.env, "result": built.first_result.shape}


if __name__ == "__main__":
    print("\n" + json.dumps(main(Path(sys.argv[1]), **json.loads(sys.argv[2]))))
