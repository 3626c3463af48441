"""Every error that a user of pcore can meet, in one tree.

A message says what was wrong, what was expected, what was found and how to mend it.
"""


class PcoreError(Exception):
    """Base class: catch this to catch everything that pcore raises on purpose."""


class InputError(PcoreError, ValueError):
    """An argument, option or array handed to pcore is not what it must be."""


class SceneError(PcoreError):
    """A scene's files are missing, damaged or inconsistent."""


class EditError(PcoreError):
    """An edit file or deformation cannot be applied."""


class CheckpointError(PcoreError):
    """A checkpoint or run folder is not ours, damaged or of another version."""


class WeightsError(PcoreError):
    """Weights of a loss or metric that was asked for are missing."""


class TrainingError(PcoreError):
    """Training cannot go on (empty cloud, non-finite loss, output not writable)."""


class DependencyError(PcoreError, ImportError):
    """An optional package is missing; the message names the extra that brings it."""


class StorageError(PcoreError, OSError):
    """The storage of a sweep cannot be read or written."""
