"""Write the URDF of every manipulator file given, beside it; without arguments those of urdf/.

Usage: python scripts/generate_urdf.py [MANIPULATOR ...] [-o FILE]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cdm_pin.cli import main as cdm_pin

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    """Generate each and return the worst exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("manipulators", nargs="*", metavar="MANIPULATOR", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="where to, for a single manipulator")
    args = parser.parse_args()
    files = args.manipulators or sorted((ROOT / "urdf").glob("*.yaml"))
    if args.output and len(files) != 1:
        parser.error("--output goes with one manipulator")
    return max(cdm_pin(["urdf", str(file), "-o", str(args.output or file.with_suffix(".urdf"))]) for file in files)


if __name__ == "__main__":
    sys.exit(main())
