"""Set bits of 256, as LLVM instructions on 32-bit integers, which the compiler vectorises.

From Python code, numba would widen them to 64 bits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

WORDS = 8  # of 32 bits
COUNTING = "+avx512vpopcntdq"  # processors that count bits in wide registers, twice as fast as adders


def _set_bits(_: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any) -> Any:
    """The type and the instructions of `set_bits`, for numba, which puts its own first argument before the words."""

    def generate(context: Any, builder: Any, _: Any, words: Any) -> Any:
        _, _, features = context.codegen().magic_tuple()
        return (by_counting if COUNTING in features else by_adders)(builder, words)

    return types.uint32(*[types.uint32] * WORDS), generate


set_bits: Callable[..., Any] = intrinsic(_set_bits)
"""Set bits of eight uint32, as a uint32; for compiled code."""


def by_counting(builder: Any, words: Sequence[Any]) -> Any:
    """The sum of the processor's bit counts of the words."""
    counts = [builder.ctpop(word) for word in words]
    while len(counts) > 1:
        counts = [builder.add(x, y) for x, y in zip(counts[::2], counts[1::2], strict=True)]
    return counts[0]


def by_adders(builder: Any, words: Sequence[Any]) -> Any:
    """Carry-save adders first, so that four words are counted instead of eight.

    An adder takes three bits of the same weight to a sum and a carry of twice the weight, for 32 places at once (Harley
    and Seal; H. S. Warren, Hacker's Delight, 2nd ed., section 5-1).
    """

    def masked(x: Any, shift: int, mask: int) -> Any:
        shifted = builder.lshr(x, ir.Constant(x.type, shift)) if shift else x
        return builder.and_(shifted, ir.Constant(x.type, mask))

    def doubled(x: Any, times: int) -> Any:
        return builder.shl(x, ir.Constant(x.type, times))

    def full(x: Any, y: Any, z: Any) -> tuple[Any, Any]:
        either = builder.xor(x, y)
        return builder.xor(either, z), builder.or_(builder.and_(x, y), builder.and_(either, z))

    def half(x: Any, y: Any) -> tuple[Any, Any]:
        return builder.xor(x, y), builder.and_(x, y)

    def in_fours(x: Any) -> Any:
        """Set bits of every four, in their place."""
        pairs = builder.sub(x, masked(x, 1, 0x55555555))
        return builder.add(masked(pairs, 0, 0x33333333), masked(pairs, 2, 0x33333333))

    def in_eights(low: Any, high: Any) -> Any:
        """Set bits of every eight, those of `high` twice: at most 24."""
        fours = builder.add(in_fours(low), doubled(in_fours(high), 1))
        return builder.add(masked(fours, 0, 0x0F0F0F0F), masked(fours, 4, 0x0F0F0F0F))

    ones, twos_a = full(*words[:3])
    ones, twos_b = full(ones, *words[3:5])
    ones, twos_c = full(ones, *words[5:7])
    ones, twos_d = half(ones, words[7])
    twos, fours_a = full(twos_a, twos_b, twos_c)
    twos, fours_b = half(twos, twos_d)
    fours, eights = half(fours_a, fours_b)
    # Each of the four bytes counts up to 64 bits, their sum exceeds a byte: sum them in halves.
    in_bytes = builder.add(in_eights(ones, twos), doubled(in_eights(fours, eights), 2))
    in_halves = builder.add(masked(in_bytes, 0, 0x00FF00FF), masked(in_bytes, 8, 0x00FF00FF))
    return masked(builder.add(in_halves, builder.lshr(in_halves, ir.Constant(in_halves.type, 16))), 0, 0xFFFF)
