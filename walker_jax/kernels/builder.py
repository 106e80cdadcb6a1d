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
    """llvmlite's builder, with methods for such arithmetic."""

    def __init__(self, block: ir.Block):
        super().__init__(block)
        self.lines = 0

    def arithmetic(self, name: str, *operands: Any) -> Line:
        """Write an instruction on floating-point vectors of one type, such as fmul."""
        kind = operands[0].type
        values = ", ".join([one.get_reference() for one in operands])
        return self.write(kind, f"{name} {FAST} {kind} {values}")

    def fused(self, a: Any, b: Any, c: Any) -> Line:
        """Write a b + c of floating-point vectors; it is rounded once if the processor can."""
        kind = a.type
        name = f"llvm.fmuladd.v{kind.count}{kind.element.intrinsic_name}"
        if name not in self.module.globals:
            ir.Function(self.module, ir.FunctionType(kind, [kind] * 3), name)
        values = ", ".join([f"{kind} {one.get_reference()}" for one in (a, b, c)])
        return self.write(kind, f"call {FAST} {kind} @{name}({values})")

    def write(self, kind: ir.Type, text: str) -> Line:
        """Write an instruction whose result has this type."""
        self.lines += 1
        reference = f"%x{self.lines}"  # llvmlite's own names begin with a point, or are of blocks
        line = Line(kind, reference, f"{reference} = {text}")
        self._insert(line)
        return line
