"""The one exception that a user can cause."""


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line: where, which field, its value with unit, the limit, and what to do next.
    The command line prints it without a traceback and exits with 2.
    """
