"""``cdm-pin identify``: recordings and a robot to identification.json, model.yaml and the identified URDF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, get_args

from ..console import emit, notice, table
from ..errors import InputError
from ..files import whole_folder

FEW = 8  # recordings whose notices are shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    from ..identify import Estimator
    from ..viewer import add_view_arguments

    parser.add_argument("manipulator", help="manipulator.yaml or model.yaml")
    parser.add_argument("recordings", nargs="+", metavar="recording", help="recordings to learn from")
    parser.add_argument("--holdout", action="append", default=[], metavar="RECORDING", help="a recording to judge on")
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="output folder")
    parser.add_argument(
        "--effects",
        default="",
        metavar="LIST",
        help="fitted beside the rigid body, by name and optional place, separated by commas: viscous_friction, "
        "coulomb_friction, torque_offset, rotor_inertia, coulomb_friction:joint2, joint_spring:elbow_joint, "
        "viscous_friction:finger_2_joint-finger_1_joint, torque_ripple:motor5:cycles=1 ...",
    )
    parser.add_argument("--estimator", choices=get_args(Estimator), default="weighted", help="default: weighted")
    parser.add_argument(
        "--cutoff", type=float, metavar="HZ", help="of the common filter; default: chosen from the data"
    )
    parser.add_argument(
        "--prior-weight", type=float, default=1.0, metavar="W", help="of the file's inertias where data say little"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="reduce recordings in N processes")
    parser.add_argument("--cluster", metavar="ADDRESS", help="reduce recordings on this Dask scheduler")
    parser.add_argument("--skip-bad", action="store_true", help="leave out recordings that cannot be read")
    add_view_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    from ..identified import save_identification
    from ..identify import identify
    from ..model import load_model
    from ..viewer import watch

    _check(args)
    model = load_model(args.manipulator)
    with watch(args, model, args.recordings) as watching:
        with watching.progress() as progress, _workers(args) as workers:
            result = identify(
                model,
                args.recordings,
                holdout=args.holdout,
                effects=[name.strip() for name in args.effects.split(",") if name.strip()],
                estimator=args.estimator,
                cutoff=args.cutoff,
                prior_weight=args.prior_weight,
                workers=workers,
                skip_bad=args.skip_bad,
                progress=progress,
            )
        with whole_folder(args.output) as folder:
            data = save_identification(result, folder, Path(args.output))
        for text in _notices(data):
            notice(args, text)
        emit(args, data, *_tables(data, model.motors), _closing(data, args.output))
    return 0


def _check(args: argparse.Namespace) -> None:
    if args.workers is not None and args.workers < 1:
        raise InputError(f"at least 1 process was expected, found {args.workers}", place="--workers")
    if args.workers is not None and args.cluster is not None:
        raise InputError("give one of --workers and --cluster")
    if args.cutoff is not None and not args.cutoff > 0:
        raise InputError(f"a frequency above 0 was expected, found {args.cutoff}", place="--cutoff")
    if not args.prior_weight > 0:
        raise InputError(f"a weight above 0 was expected, found {args.prior_weight}", place="--prior-weight")


def _workers(args: argparse.Namespace):
    from ..workers import Workers, cluster, processes

    if args.cluster is not None:
        return cluster(args.cluster)
    return Workers() if args.workers in (None, 1) else processes(args.workers)


def _notices(data: dict[str, Any]) -> list[str]:
    texts = [f"skipped {item['file']}: {item['reason']}" for item in data["skipped"]]
    visits = data["recordings"] + data["holdout"]
    if len(visits) > FEW:
        return [*texts, f"{len(visits)} recordings: what was noticed in each stands in identification.json"]
    for visit in visits:
        texts += [f"{visit['name']}: {text}" for text in visit["notices"]]
        texts += [f"{visit['name']}: {count} samples {reason}" for reason, count in visit["left_out"].items()]
    return texts


def _tables(data: dict[str, Any], motors: tuple[str, ...]) -> list[Any]:
    shown = []
    rows = [[p["name"], p["value"], p["std"], p["nominal"]] for p in data["base_parameters"]]
    rows += [
        [f"{e['effect']} {e['location']['kind']} {e['location'].get('index', '')}: {name}", p["value"], p["std"], None]
        for e in data["effects"]
        for name, p in e["parameters"].items()
    ]
    if rows:
        shown.append(table("Identified parameters", ["parameter", "value", "std", "nominal"], rows))
    if data["not_identifiable"]:
        rows = [[item["name"], item["reason"]] for item in data["not_identifiable"]]
        shown.append(table("Not identifiable from these recordings", ["parameter", "reason"], rows))
    errors = [(name, data["fit"][name]) for name in ("train", "holdout") if data["fit"][name]]
    rows = [
        [motor, name, e["rmse"][i], 100 * e["relative"][i], e["noise_floor"][i]]
        for name, e in errors
        for i, motor in enumerate(motors)
    ]
    if rows:
        header = ["motor", "on", "rms error", "of the torque [%]", "noise floor"]
        shown.append(table("Torque predicted", header, rows))
    return shown


def _closing(data: dict[str, Any], output: str) -> str:
    lines = [f"{data['rank']} of {data['structural_rank']} base parameters, {data['samples']} samples"]
    if data["condition_number"] is not None:
        lines[0] += f", condition number {data['condition_number']:.3g}"
    lines += [f"Links {data['physical']['links']}", *data["hints"]]
    return "\n".join([*lines, f"Written: {output}/identification.json, model.yaml, identified.urdf"])
