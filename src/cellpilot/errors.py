"""Errors a person can act on. The command line turns each into one line and exit code 2."""


class InputError(ValueError):
    """Something given from outside cannot be used: says what was found, where, what was expected, what to do."""


class RangeError(InputError):
    """A physical quantity lies outside the range for which a model is defined."""


class WriteError(InputError):
    """A file could not be written: no room, no permission, no such place."""
