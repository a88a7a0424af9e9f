"""The quick way for :class:`Innovation`: one goes out for every measurement that comes in."""

from __future__ import annotations

import struct
from math import isfinite

from fbn_common.records import Innovation, Verdict
from fbn_ros.primitives import PREFIX, numbers_at, put_numbers, put_text, put_time, text_at, time_at

_ANSWER = struct.Struct("<dBB")  # NIS, degrees of freedom, verdict


def encode(record: Innovation) -> bytes:
    """The bytes of the record's message."""
    body = bytearray()
    put_time(body, record.stamp_ns)
    put_text(body, record.frame_id)
    put_text(body, record.sensor)
    put_numbers(body, record.innovation)
    put_numbers(body, record.sigma)
    body += b"\0" * (-len(body) % 8) + _ANSWER.pack(record.nis, record.dof, record.verdict)
    put_text(body, record.reason)
    return PREFIX + bytes(body)


def decode(data: bytes) -> Innovation | None:
    """The record; None if these bytes need the slow way (other byte order, too short, or something is wrong)."""
    if data[:4] != PREFIX:
        return None
    body = data[4:]
    try:
        stamp_ns, position = time_at(body, 0)
        frame_id, position = text_at(body, position)
        sensor, position = text_at(body, position)
        innovation, position = numbers_at(body, position)
        sigma, position = numbers_at(body, position)
        position += -position % 8
        nis, dof, verdict = _ANSWER.unpack_from(body, position)
        reason, _ = text_at(body, position + _ANSWER.size)
        record = Innovation(stamp_ns, frame_id, sensor, nis, dof, Verdict(verdict), reason, innovation, sigma)
    except (struct.error, ValueError):
        return None
    return record if isfinite(nis + innovation.sum() + sigma.sum()) else None
