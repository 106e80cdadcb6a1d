"""The errors that the package raises: for wrong use, and for a computation that failed."""


class Refusal(Exception):
    """An error of one line, in one part or two: what is wrong, and what to do.

    It is `of` arguments, whose names have spaces between them: the last part says each, last as a
    word of its own. The command line puts its options in their places.
    """

    def __init__(self, *said: str, of: str = ""):
        super().__init__(*said)
        self.arguments = of.split()

    def __str__(self):
        return ": ".join(map(str, self.args))


class WrongUse(Refusal, ValueError):
    """An argument is refused. The package raises no other `ValueError` of its own.

    So one that is no `WrongUse` comes from within a computation, as NumPy's `LinAlgError` does.
    """


class WrongPlace(WrongUse):
    """A place on disk is refused: what is wrong there, and perhaps the arguments that help."""


class ComputationFailed(Refusal, RuntimeError):
    """A computation came to no answer, for the reason given, though its arguments are right."""


class NotWritten(ComputationFailed):
    """The system refuses to write a result: where and why, and how it is resumed."""
