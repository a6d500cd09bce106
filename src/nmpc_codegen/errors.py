"""Every error and warning that the package raises on purpose."""

__all__ = ["BuildError", "ControllerError", "ExportError", "NmpcError", "OptionError", "ProblemError", "ProblemWarning"]


class NmpcError(Exception):
    """Base of all errors of this package; its message names the thing and what was expected."""


class ProblemError(NmpcError, ValueError):
    """The optimal control problem is stated wrongly."""


class OptionError(NmpcError, ValueError):
    """An option has a value that is not allowed, or two options clash."""


class BuildError(NmpcError, RuntimeError):
    """The C compiler is missing or refused the generated code."""


class ExportError(NmpcError, OSError):
    """A folder cannot be written to, or holds something that export() must not replace."""


class ControllerError(NmpcError, RuntimeError):
    """A controller was called wrongly, or failed while on_failure="raise"."""


class ProblemWarning(UserWarning):
    """The problem is legal, but something in it is likely to disappoint."""
