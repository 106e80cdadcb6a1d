"""A builder of LLVM programs that writes arithmetic on floating-point vectors as text at once.

Nine of ten instructions of a stride are arithmetic. llvmlite makes an object for each, and writes
its text later. That takes three times as long.
"""

from typing import Any, no_type_check

from llvmlite import ir

FAST = "contract"
"""Allow fused multiply-add, as XLA does, and no other departure from IEEE arithmetic."""


@no_type_check  # made for every number of a program, as are its methods' calls
class Line:
    """An instruction as text, which other instructions take as an operand."""

    __slots__ = "reference", "text", "type"

    def __init__(self, kind: ir.Type, reference: str, text: str):
        self.type, self.reference, self.text = kind, reference, text

    def get_reference(self) -> str:
        return self.reference

    def __str__(self) -> str:
        return self.text


@no_type_check
class Builder(ir.IRBuilder):
    """llvmlite's builder, with one more method."""

    def __init__(self, block: ir.Block):
        super().__init__(block)
        self.lines = 0

    def arithmetic(self, name: str, *operands: Any) -> Line:
        """Write an instruction on floating-point vectors of one type, such as fmul."""
        kind, self.lines = operands[0].type, self.lines + 1
        values = ", ".join([one.get_reference() for one in operands])
        reference = f"%x{self.lines}"  # llvmlite's own names begin with a point, or are of blocks
        line = Line(kind, reference, f"{reference} = {name} {FAST} {kind} {values}")
        self._insert(line)
        return line
