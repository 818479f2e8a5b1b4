"""The virtual rig as a program, for tests with other host software."""

from __future__ import annotations

import argparse
import signal
import sys
from dataclasses import fields

from tacbench_cad.extensions.virtual_rig.faults import KINDS as FAULTS
from tacbench_cad.extensions.virtual_rig.faults import Fault, settings_of
from tacbench_cad.extensions.virtual_rig.server import VirtualRig
from tacbench_cad.extensions.virtual_rig.setup import KINDS, Setup
from tacbench_cad.util.errors import TacbenchError


def main() -> int:
    """Parse the command line and serve.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(
        prog="python -m tacbench_cad.extensions.virtual_rig",
        description="Simulated stage firmware and load cell on pseudo-terminals or TCP ports. No hardware is involved.",
        epilog="Example: %(prog)s grbl --speed 10 --fault 'drop at_s=30 count=3 direction=in'",
    )
    parser.add_argument("kind", nargs="?", choices=KINDS, default="grbl", help="which firmware (grbl)")
    parser.add_argument("--speed", type=float, default=1.0, help="times faster than real time (1)")
    parser.add_argument("--seed", type=int, default=0, help="of everything left to chance (0)")
    parser.add_argument("--tcp", action="store_true", help="TCP ports instead of pseudo-terminals")
    parser.add_argument("--no-reset-on-open", action="store_true", help="opening the port does not reset the board")
    parser.add_argument(
        "--flat", nargs=2, type=float, metavar=("Z_MM", "N_PER_MM"), help="a flat spring under the carriage"
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="'KIND KEY=VALUE ...'",
        help=f"kinds: {', '.join(FAULTS)}; keys: {', '.join(field.name for field in fields(Fault)[1:])}",
    )
    for name, of in (("--option", "the firmware, as emergency_parser=1"), ("--gauge", "the load cell, as newtons=1")):
        parser.add_argument(name, action="append", default=[], metavar="KEY=VALUE", help=f"a setting of {of}")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        values = {name: getattr(options, name) for name in ("kind", "speed", "seed", "tcp")}
        if options.flat is not None:
            values["stimulus"] = dict(zip(("flat_z_mm", "n_per_mm"), options.flat, strict=True))
        values |= {"resets_on_open": not options.no_reset_on_open, "faults": options.fault}
        rig = VirtualRig(Setup.of(**settings_of(options.option) | values, gauge=settings_of(options.gauge)))
    except TacbenchError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(
        f"SIMULATED {options.kind} stage on {rig.port}\nSIMULATED load cell on {rig.gauge_port}\nCtrl-C ends it.",
        file=sys.stderr,
        flush=True,
    )
    try:
        rig.run()
    except KeyboardInterrupt:
        return 130
    finally:
        rig.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
