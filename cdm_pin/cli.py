"""The console script: arguments to calls to files; every error of the user becomes one line and exit status 2."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from .errors import CdmError

# The matrices here are small: threads of the linear algebra cost more than they gain, and change the last digits.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

COMMANDS = {
    "urdf": "generate the URDF of a manipulator",
    "torque": "compute motor torques along a recording",
    "estimate": "predict the output side of the transmission from its input side",
    "excite": "plan a safe, informative excitation trajectory",
    "simulate": "run a trajectory in closed loop on an independent simulator",
    "identify": "turn recordings into an identified model",
    "diagnose": "find, name and model the physics that a model leaves out",
    "view": "show a robot, a recording or a result in the browser",
}

OK, INTERNAL_ERROR, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def error(self, message: str):
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """Build the parser; with `only`, just that command's arguments are filled in (its module alone is imported)."""
    parser = _Parser(prog="cdm-pin", description="Cable-driven manipulators: model, identify, diagnose.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    parser.add_argument("--print-completion", choices=("bash", "zsh", "tcsh"), help="print a shell completion script")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_Parser)
    for name, summary in COMMANDS.items():
        if only in (None, name):
            module = importlib.import_module(f".commands.{name}", __package__)
            sub = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
            module.add_arguments(sub)
            sub.set_defaults(run=module.run)
            add_common_arguments(sub)
        else:
            commands.add_parser(name, help=summary, add_help=False)
    return parser


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what every command takes."""
    group = parser.add_argument_group("console")
    group.add_argument("--quiet", action="store_true", help="print nothing but errors")
    group.add_argument("--json", action="store_true", help="print the result as JSON instead of tables")
    group.add_argument("--debug", action="store_true", help="show the traceback of an internal error")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the console script and return its exit status: 0 done, 1 internal error, 2 bad input, 130 interrupted."""
    argv = list(sys.argv[1:] if argv is None else argv)
    command = next((word for word in argv if word in COMMANDS), None)
    try:
        parser = build_parser(None if "--print-completion" in argv else command or "")
        args = parser.parse_args(argv)
        if args.version:
            from importlib.metadata import version

            print(version("cdm-pin"))
            return OK
        if args.print_completion:
            import shtab

            print(shtab.complete(parser, args.print_completion))
            return OK
        if args.command is None:
            parser.print_help()
            return OK
        return int(args.run(args) or OK)
    except CdmError as exc:
        print(f"cdm-pin: {exc}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("cdm-pin: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except Exception as exc:
        if "--debug" in argv:
            raise
        print(f"cdm-pin: internal error: {type(exc).__name__}: {exc} (--debug shows where)", file=sys.stderr)
        return INTERNAL_ERROR


if __name__ == "__main__":
    sys.exit(main())
