"""Packets written down a second time, from the words of `heliograph.link.packet_layout` alone: bits as text, no tables.

Nothing is shared with the code under test but the sentences of the layout. The CRC is a long division, the code two
sums of delayed bits, the interleaver a list that is walked, the scrambler a register with nine cells.
"""

from __future__ import annotations

from math import gcd

SYNC = "111100110011010010101000"


def number(value: int, bits: int) -> str:
    """Return a number, most significant bit first."""
    return format(value, f"0{bits}b")


def crc32(bits: str) -> str:
    """Return the CRC of whole bytes: each byte reversed, the first 32 bits inverted, divided by 0x104C11DB7."""
    reflected = "".join(bits[i : i + 8][::-1] for i in range(0, len(bits), 8))
    inverted = "".join("10"[int(bit)] if i < 32 else bit for i, bit in enumerate(reflected + "0" * 32))
    divisor = number(0x104C11DB7, 33)
    rest = [int(bit) for bit in inverted]
    for i in range(len(reflected)):
        if rest[i]:
            for k in range(33):
                rest[i + k] ^= int(divisor[k])
    return "".join(str(1 - bit) for bit in rest[-32:])[::-1]


def coded(bits: str, keep_a: str, keep_b: str) -> str:
    """Return the code bits that are sent."""
    u = [int(bit) for bit in bits]

    def delayed(t: int, *delays: int) -> str:
        return str(sum(u[t - d] for d in delays if t >= d) % 2)

    out = ""
    for t in range(len(u)):
        if keep_a[t % len(keep_a)] == "1":
            out += delayed(t, 0, 1, 2, 3, 6)
        if keep_b[t % len(keep_b)] == "1":
            out += delayed(t, 0, 2, 3, 5, 6)
    return out


def interleaved(code: str) -> str:
    """Return the code bits in the order of the air: every S-th, round and round."""
    n = len(code)
    step = next(s for s in range(-(-n // 7), n) if gcd(s, n) == 1)
    at, out = 0, ""
    for _ in range(n):
        out += code[at]
        at = (at + step) % n
    return out


def scrambled(bits: str) -> str:
    """Return the bits, inverted where a register of nine cells, ones at first, puts out a one."""
    cells, out = [1] * 9, ""
    for bit in bits:
        out += str(int(bit) ^ cells[8])
        cells = [cells[8] ^ cells[4], *cells[:8]]
    return out


def packet(address: int, text: bool, message: int, fragment: int, more: bool, data: bytes) -> dict[str, str]:
    """Return the stages of a packet with 16 bytes of data at rate 2/3, as bits."""
    used = 31 if more else len(data)
    header = number(address, 8) + str(int(text)) + number(message, 4) + number(fragment, 6) + number(used, 5)
    body = header + "".join(number(byte, 8) for byte in data) + "0" * (8 * (16 - len(data)))
    before = body + crc32(body) + "000000"
    code = coded(before, "10", "11")
    return {"crc": crc32(body), "before_code": before, "code": code, "air": SYNC + scrambled(interleaved(code))}
