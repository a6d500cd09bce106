"""The compiler is locked to one call at a time, because CasADi counts references to its objects without locks.

A process that is forked while another thread compiles would inherit a lock that nobody releases, and half-loaded
modules. Therefore a fork waits for the end of the call, and also while a package's description is read.
"""

from __future__ import annotations

import os
import threading

COMPILING = threading.RLock()

if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=COMPILING.acquire, after_in_parent=COMPILING.release, after_in_child=COMPILING.release)
