"""The error tree: every error the library raises on bad input derives from `CgtorchError`.

Each message is one line that names what was wrong, its value, and what to do about it.
"""


class CgtorchError(Exception):
    """Root of every error that cgtorch raises on purpose."""


class SettingsError(CgtorchError, ValueError):
    """A setting, command-line option or argument has a value that cannot be used."""


class RobotError(CgtorchError, ValueError):
    """A URDF or robot description is broken, incomplete or inconsistent."""


class DataError(CgtorchError, ValueError):
    """Training data have the wrong shape, too few rows, one class only, or non-finite values."""


class ModelError(CgtorchError, ValueError):
    """A model file cannot be read, or a model was used before it was fitted."""


class GraphError(CgtorchError, ValueError):
    """A computational graph is invalid, or a skill file does not describe one."""


class ActionError(CgtorchError, ValueError):
    """An action is unknown, or breaks the action interface."""


class RunError(CgtorchError, OSError):
    """A run folder is missing, unwritable, of another version, or damaged."""
