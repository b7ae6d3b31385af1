"""Constraint studies: `transopt study`, callable from a checkout.

    python scripts/constraint_study.py SCENE --vary KEY=V1,V2,... --out DIR

Options, files and exit codes are those of `transopt study --help`.
"""

import sys

from transopt.cli.main import main

if __name__ == "__main__":
    sys.argv[:1] = ["transopt", "study"]
    main()
