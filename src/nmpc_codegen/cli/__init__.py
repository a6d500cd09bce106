"""nmpc-export leads from a Python file that states a problem to a folder of C99.

    arguments -> problem_file -> settings -> export -> printing -> check, simulate

Exit status: 0 for success, 1 if problem, options or check failed (the message says where), 2 for wrong usage.
"""

from nmpc_codegen.cli.command import main

__all__ = ["main"]
