"""The error classes: every error of the library for bad input derives from `CgtorchError`.

Each message is one line that names what is wrong, its value, and what to do. As values may come
from hostile files, it is always printable and of bounded length.
"""

BEGINNING, END = 450, 150  # characters that stay of a long message: what is wrong, and what to do


class CgtorchError(Exception):
    """The base class of all errors that cgtorch raises on purpose."""

    def __str__(self) -> str:
        """The message on one line, shortened in the middle if it is long."""
        text = super().__str__()
        if len(text) > BEGINNING + END:
            text = f"{text[:BEGINNING]} … {text[-END:]}"
        return printable(text)


def printable(text: str) -> str:
    """Text from an untrusted file, with escapes for characters that cannot be printed."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class SettingsError(CgtorchError, ValueError):
    """A setting, command-line option or argument has a value that cannot be used."""


class RobotError(CgtorchError, ValueError):
    """A URDF or robot description is broken, incomplete or inconsistent."""


class CompilerError(CgtorchError, RuntimeError):
    """Compiled code is needed, and there is neither a C compiler nor a library for this machine."""


class DataError(CgtorchError, ValueError):
    """Training data have the wrong shape, too few rows, one class only, or non-finite values."""


class ModelError(CgtorchError, ValueError):
    """A model file cannot be read, or a model was used before it was fitted."""


class GraphError(CgtorchError, ValueError):
    """A computational graph is invalid, or a skill file does not contain one."""


class ActionError(CgtorchError, ValueError):
    """An action is unknown, or breaks the action interface."""


class WorldError(CgtorchError, ValueError):
    """A world or another environment breaks the environment interface."""


class DomainError(CgtorchError, ValueError):
    """A domain is unknown, or breaks the domain interface."""


class RobotStoppedError(CgtorchError, RuntimeError):
    """The robot has stopped for safety, and the run pauses."""


class RunError(CgtorchError, OSError):
    """A run folder is missing, unwritable, of another version, or damaged."""
