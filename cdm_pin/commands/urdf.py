"""``cdm-pin urdf MANIPULATOR -o FILE``: the URDF of an arm, read back before it is written."""

from __future__ import annotations

import argparse

import numpy as np

from ..console import emit, table
from ..errors import CdmError
from ..files import write_text
from ..manipulator import load_manipulator
from ..routing import joint_limits
from ..urdf import generate_urdf
from ..urdf_check import urdf_deviation

TOLERANCE = 1e-9  # [SI units] between what was written and what is read back


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("manipulator", metavar="MANIPULATOR", help="manipulator.yaml or model.yaml with links")
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="URDF to write")


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    manipulator = load_manipulator(args.manipulator)
    text = generate_urdf(manipulator)
    deviation = urdf_deviation(text, manipulator)
    if not max(deviation.values()) < TOLERANCE:
        raise CdmError(f"{args.output}: not written, read back it differs by {deviation} from {args.manipulator}")
    write_text(args.output, text)
    assert manipulator.pulleys is not None
    limits = joint_limits(manipulator.links, manipulator.pulleys)
    joints = [
        {"joint": f"joint_{i + 1}", "link": link.name, "mass": link.mass, "lower": lower, "upper": upper}
        for i, (link, (lower, upper)) in enumerate(zip(manipulator.links, limits, strict=True))
    ]
    rows = [[j["joint"], j["link"], j["mass"], *np.degrees([j["lower"], j["upper"]])] for j in joints]
    header = ("joint", "link", "mass [kg]", "lower limit [deg]", "upper limit [deg]")
    emit(
        args,
        {"file": args.output, "joints": joints, "read_back": deviation},
        table(f"{manipulator.name}: limits of the cable mechanism", header, rows),
        f"wrote {args.output}; read back with Pinocchio and yourdfpy, equal to {max(deviation.values()):.0e}",
    )
    return 0
