"""The one exception root of the project, caught once in the launcher."""


class MiniloopError(Exception):
    """Something the user can act on: what was wrong, where, and what to do, in one line.

    The launcher prints the message and exits with status 1; no traceback unless `--debug`.
    """


class InputError(MiniloopError):
    """A file or folder that was given cannot be used as it is (names the file, and the line or frame)."""


class ConfigError(MiniloopError):
    """A setting is unknown or out of range (names the key and where it came from)."""


class RegistrationError(MiniloopError):
    """The scans could be read but no trajectory can be had from them (says why)."""
