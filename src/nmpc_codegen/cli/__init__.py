"""nmpc-export: from a Python file that states a problem to a folder of C99.

    arguments -> problem_file -> settings -> export -> printing -> check, simulate

Exit status: 0 done; 1 the problem, the options or the check failed, the message says where; 2 wrong usage.
"""

from nmpc_codegen.cli.command import main

__all__ = ["main"]
