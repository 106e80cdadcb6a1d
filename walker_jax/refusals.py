"""The errors that the package raises, for wrong use and for failed computations."""


class Refusal(Exception):
    """An error of one line, in one part or two: what is wrong, and what to do.

    `of` names the arguments at fault, separated by spaces. The last part of the message contains
    each name as a word; the command line puts its options in their places.
    """

    def __init__(self, *said: str, of: str = ""):
        super().__init__(*said)
        self.arguments = of.split()

    def __str__(self):
        return ": ".join(map(str, self.args))


class WrongUse(Refusal, ValueError):
    """An argument is refused. The package raises no other `ValueError` of its own.

    A `ValueError` that is no `WrongUse` comes from within a computation, as NumPy's `LinAlgError`
    does.
    """


class WrongPlace(WrongUse):
    """A place on disk is refused: the message says what is wrong, and which arguments may help."""


class TooLarge(WrongUse, MemoryError):
    """A computation needs more memory than this machine has."""


class ComputationFailed(Refusal, RuntimeError):
    """A computation failed, for the reason given, though its arguments are right."""


class NotWritten(ComputationFailed):
    """The system refused to write a result: the message says where, why, and how to resume."""
