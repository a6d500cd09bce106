"""Hostile problem files and command lines, and the required behaviour of the command."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

#: A problem that exports quickly.
GOOD = """\
from nmpc_codegen import OCP, Options, ExplicitRungeKutta

def good(cls=OCP):
    ocp = cls("cart", T=1.0, N=3)
    p, v, a = ocp.state("p", initial=1.0), ocp.state("v"), ocp.control("a")
    ocp.dynamics({p: v, v: a})
    ocp.least_squares(ocp.x, weight=1.0)
    ocp.least_squares(a, weight=1.0, names=["effort"])
    ocp.subject_to(-1, a, 1)
    return ocp

"""

EXCEPTIONS = {
    "empty": "ValueError()",
    "lines": "ValueError('a\\n\\n b\\r\\n c')",
    "escapes": "ValueError('\\x1b[31m \\x00 \\x07')",
    "unencodable": "ValueError('\\u03c0 \\ud800')",
    "markup": "ValueError('[red]x[/] [/nothing] :smile:')",
    "long": "ValueError('x' * 10**6)",
    "str raises": "type('E', (Exception,), {'__str__': lambda s: 1 / 0})()",
    "str is no str": "type('E', (Exception,), {'__str__': lambda s: 3})()",
    "repr and str raise": "type('E', (Exception,), {'__str__': lambda s: 1 / 0, '__repr__': lambda s: 1 / 0})()",
    "odd class name": "type('E\\n\\x1b[1m', (Exception,), {})('x')",
    "base exception": "type('E', (BaseException,), {})('base')",
    "exit": "SystemExit()",
    "exit 0": "SystemExit(0)",
    "exit huge": "SystemExit(10**30)",
    "exit text": "SystemExit('text')",
    "exit object": "SystemExit(object())",
    "interrupt": "KeyboardInterrupt()",
    "generator exit": "GeneratorExit()",
    "memory": "MemoryError()",
    "recursion": "RecursionError()",
    "group": "ExceptionGroup('several', [ValueError(1), TypeError(2)])",
    "os error": "OSError(13, 'no', '/a\\nb')",
    "unicode": "UnicodeDecodeError('utf-8', b'x', 0, 1, 'why')",
    "syntax": "SyntaxError('odd', (None, None, None, None))",
    "stop": "StopIteration(3)",
    "broken pipe": "BrokenPipeError()",
    "our own": "__import__('nmpc_codegen').ProblemError('')",
    "own context": "(lambda e: (setattr(e, '__cause__', KeyError(e)), e)[1])(ValueError('loop'))",
}

PLACES = {
    "module": "raise {e}\n",
    "problem()": "def problem():\n    raise {e}\n",
    "build_ocp()": "def build_ocp():\n    raise {e}\n",
    "options()": "ocp = good()\ndef options():\n    raise {e}\n",
    "attribute": "class C(OCP):\n    @property\n    def states(self):\n        raise {e}\nocp = good(C)\n",
    "handler": "try:\n    1 / 0\nexcept ZeroDivisionError:\n    raise {e}\n",
}

TAMPERING = {
    "stdout closed": "import sys; sys.stdout.close(); sys.__stdout__.close()",
    "both closed": "import sys; sys.stdout.close(); sys.stderr.close(); sys.__stderr__.close()",
    "stdout detached": "import sys; sys.stdout.detach(); sys.__stdout__.detach()",
    "streams are None": "import sys; sys.stdout = sys.stderr = sys.__stdout__ = None",
    "stdout raises": "import sys; sys.stdout = type('S', (), {'write': lambda *a: 1 / 0, 'flush': lambda *a: 1 / 0})()",
    "descriptor closed": "import os; os.close(1)",
    "excepthook": "import sys; sys.excepthook = lambda *a: 1 / 0",
    "unraisablehook": "import sys; sys.unraisablehook = None",
    "chdir": "import os; os.chdir('/')",
    "path": "import sys; sys.path = None",
    "argv": "import sys; sys.argv = 3",
    "recursion limit": "import sys; sys.setrecursionlimit(60)",
    "warnings as errors": "import warnings; warnings.simplefilter('error')",
    "warning": "import warnings; warnings.warn('a\\nb \\u03c0 [red]')",
    "floating point": "import numpy; numpy.seterr(all='raise')",
    "thread": "import threading; t = threading.Thread(target=lambda: 1 / 0); t.start(); t.join()",
    "finaliser": "class D:\n    def __del__(self): 1 / 0\nD()",
    "locale": "import os; os.environ.clear()",
    "trace": "import sys; sys.settrace(lambda *a: None)",
    "modules": "import sys; sys.modules['json'] = None",
    "random names": "__name__ = 3; __file__ = None; __builtins__ = 7",
    "prints": "print('\\u03c0 \\ud800 [red]')",
}

ENDINGS = {"stated": "\nocp = good()\n", "raises": "\nraise ValueError('end')\n", "empty": "\n"}

ATTRIBUTES = ("N", "T", "dt", "name", "states", "controls", "parameters", "rows", "discrete", "_N", "_dt", "_states")
NONSENSE = (
    "'x'",
    "None",
    "-1",
    "1e-320",
    "float('nan')",
    "10**7",
    "object()",
    "[[]]",
    "'main'",
    "'a\\nb'",
    "lambda: 1",
)

STATEMENTS = {
    "ocp": ("3", "None", "good", "OCP", "[good()]", "(good(), Options())", "object()"),
    "options": ("3", "'fast'", "Options", "lambda a: a", "lambda: 3", "print", "[]", "Options().qp"),
    "problem": ("3", "lambda: 3", "lambda: (good(), 3)", "lambda: (good(), None)", "lambda x: x", "lambda: ()", "OCP"),
    "build_ocp": ("lambda: None", "lambda: (good(),)", "lambda x: x", "int", "object()"),
}

CONTENTS = {
    "empty": b"",
    "null": b"\0" * 10,
    "null in text": b"x = 1\0\n",
    "binary": bytes(range(256)) * 20,
    "not UTF-8": b"x = '\xff\xfe'\n",
    "declared wrongly": b"# coding: utf-99\nx = 1\n",
    "UTF-16": "x = 1\n".encode("utf-16"),
    "byte order mark": b"\xef\xbb\xbfx = 1\n",
    "brackets": b"(" * 5000,
    "minus signs": b"x = " + b"-" * 5000 + b"1\n",
    "unclosed": b"def f(:\n",
    "indentation": b"if True:\nx\n  y\n",
    "returns": b"return 3\n",
    "awaits": b"await x\n",
    "long line": b"x = '" + b"a" * 10**6 + b"'\n",
    "import of nothing": b"import no_such_module\n",
    "import of broken": b"import broken\n",
    "import of itself": b"import problem\n",
    "star": b"from nmpc_codegen import *\n",
    "huge integer": b"x = " + b"9" * 6000 + b"\n",
}

VALUES = ("", "=", "-1", "1e400", "9" * 5000, "(" * 3000, "[]", "\x1b[31m", "[red]x[/]", "\u03c0", "a\nb", "\udcff")
KEYS = ("", "..", "qp", "qp.max_iterations", "integrator.tableau.a", "algorithm.shift", "speed", "qp.__dict__")
FLAGS = {
    "--output": ("", "/dev/null/x", "problem.py", "x" * 300, "a\nb", "\udcff", "a\0b"),
    "--name": ("", "3d", "int", "a" * 10000, "a\nb", "../x", "a\0b"),
    "--plot": ("x.docx", "/dev/null/x.png", ".png", "a\0.png"),
    "--simulate": ("0", "1e3", "9" * 5000),
}


@dataclass(frozen=True)
class Case:
    """A command line in a folder with some files; ``statuses``: its allowed exit statuses."""

    name: str
    arguments: tuple[str, ...]
    files: dict[str, bytes] = field(default_factory=dict)
    statuses: tuple[int, ...] = (0, 1, 2)


def _file(name: str, text: str | bytes, *arguments: str, statuses: tuple[int, ...] = (0, 1)) -> Case:
    content = text if isinstance(text, bytes) else text.encode("utf-8")
    files = {"problem.py": content, "broken.py": b"x = (\n"}
    return Case(name, ("problem.py", "-o", "out", *arguments), files, statuses)


def _line(name: str, *arguments: str, statuses: tuple[int, ...] = (0, 1, 2)) -> Case:
    return Case(name, ("problem.py", *arguments), {"problem.py": (GOOD + "ocp = good()\n").encode()}, statuses)


def files() -> Iterator[Case]:
    """Every hostile file."""
    for (place, text), (kind, raised) in itertools.product(PLACES.items(), EXCEPTIONS.items()):
        yield _file(f"raised in {place}: {kind}", GOOD + text.replace("{e}", raised), statuses=(1,))
    for (what, text), (ending, rest) in itertools.product(TAMPERING.items(), ENDINGS.items()):
        yield _file(f"{what}, {ending}", GOOD + text + rest, statuses=(0, 1) if ending == "stated" else (1,))
    for attribute, value in itertools.product(ATTRIBUTES, NONSENSE):
        yield _file(f"ocp.{attribute} = {value}", f"{GOOD}ocp = good()\nocp.{attribute} = {value}\n")
    for name, values in STATEMENTS.items():
        for value in values:
            stated = "ocp = good()\n" if name == "options" else ""
            yield _file(f"{name} = {value}", f"{GOOD}{stated}{name} = {value}\n")
    for what, content in CONTENTS.items():
        yield _file(f"content: {what}", content, statuses=(1,))
    yield Case("a folder", ("problem.py",), {"problem.py/x": b""}, (1,))
    yield Case("no file", ("problem.py",), {}, (1,))
    yield Case("a device", ("/dev/zero",), {}, (1,))


def lines() -> Iterator[Case]:
    """Command lines: every unusual value of every flag, and of some settings."""
    for flag, values in FLAGS.items():
        for value in values:
            yield _line(f"{flag} {value[:40]!r}", f"{flag}={value}")
    for key, value in itertools.product(KEYS, VALUES):
        yield _line(f"--set {key}={value[:40]!r}", "--set", f"{key}={value}")


def catalogue() -> list[Case]:
    """All cases."""
    return [*files(), *lines()]
