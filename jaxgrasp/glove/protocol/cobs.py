"""Consistent overhead byte stuffing: any bytes without a zero among them, so that a zero can end a frame.

Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999.
"""

LONGEST_RUN = 254
"""Largest number of bytes without a zero after a code byte."""


def stuff(data: bytes) -> bytes:
    """Encode bytes without zeros; the result is longer by a byte for every 254 begun."""
    out = bytearray()
    for run in data.split(b"\0"):
        while len(run) >= LONGEST_RUN:
            out.append(LONGEST_RUN + 1)
            out += run[:LONGEST_RUN]
            run = run[LONGEST_RUN:]
        out.append(len(run) + 1)
        out += run
    return bytes(out)


def unstuff(data: bytes) -> bytes | None:
    """Decode stuffed bytes; return None if they are not a valid encoding."""
    out = bytearray()
    position, size = 0, len(data)
    while position < size:
        code = data[position]
        end = position + code
        if code == 0 or end > size:
            return None
        out += data[position + 1 : end]
        position = end
        if code <= LONGEST_RUN and position < size:
            out.append(0)
    return None if b"\0" in data or not data else bytes(out)
