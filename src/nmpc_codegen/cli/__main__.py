"""The command can be started by python -m nmpc_codegen.cli."""

import sys

from nmpc_codegen.cli.command import main

sys.exit(main())
