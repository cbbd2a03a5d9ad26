#!/usr/bin/env python3
"""Joins the pictures of a folder, in the order of their names, into an animated WebP that repeats. drag.mjs runs it.

usage: join_frames.py FOLDER OUT.webp FRAMES_PER_SECOND MOST_BYTES      (needs Pillow)

Pillow can write such a file as well. Its encoder leaves out pixels that change only a little, which shows as blocks on a smooth
surface that moves. Here a frame contains every block of pixels that is not equal to the same block of the frame before.
"""

import io
import pathlib
import struct
import sys

from PIL import Image, ImageChops

# The first quality whose file is small enough is used.
QUALITIES = [92, 88, 84, 80, 75, 70, 60, 50]
# Width and height of the blocks that a frame contains or leaves out.
BLOCK = 8
ANIMATED, WITH_ALPHA = 0x02, 0x10


def chunk(name: bytes, content: bytes) -> bytes:
    """A part of a WebP file; its length is even."""
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)


def three_bytes(*numbers: int) -> bytes:
    """Numbers of 24 bits, as WebP writes places and sizes."""
    return b"".join(number.to_bytes(3, "little") for number in numbers)


def encoded(picture: Image.Image, quality: int) -> bytes:
    """The parts of a WebP file that contain the pixels of one picture."""
    file = io.BytesIO()
    picture.save(file, "WEBP", quality=quality, method=6)
    data, at, parts = file.getvalue(), 12, b""
    while at < len(data):
        name, length = data[at : at + 4], struct.unpack_from("<I", data, at + 4)[0]
        if name in (b"ALPH", b"VP8 ", b"VP8L"):
            parts += chunk(name, data[at + 8 : at + 8 + length])
        at += 8 + length + length % 2
    return parts


def changed_part(before: Image.Image, frame: Image.Image) -> tuple[int, int, Image.Image]:
    """The smallest rectangle around what changed, and where it is; blocks that did not change are transparent."""
    red, green, blue = ImageChops.difference(before, frame).split()
    most = ImageChops.lighter(ImageChops.lighter(red, green), blue)
    alpha = Image.new("L", frame.size)
    for top in range(0, frame.height, BLOCK):
        for left in range(0, frame.width, BLOCK):
            block = (left, top, min(left + BLOCK, frame.width), min(top + BLOCK, frame.height))
            if most.crop(block).getbbox() is not None:
                alpha.paste(255, block)
    shown = frame.copy()
    shown.putalpha(alpha)
    left, top, right, bottom = alpha.getbbox() or (0, 0, 2, 2)
    left, top = left - left % 2, top - top % 2
    return left, top, shown.crop((left, top, right, bottom))


def animation(frames: list[Image.Image], quality: int, duration: int) -> bytes:
    """The file. Each frame is drawn over the one before."""
    width, height = frames[0].size
    parts = chunk(b"VP8X", bytes([ANIMATED | WITH_ALPHA, 0, 0, 0]) + three_bytes(width - 1, height - 1))
    parts += chunk(b"ANIM", bytes(6))
    for before, frame in zip([None, *frames], frames):
        left, top, part = (0, 0, frame) if before is None else changed_part(before, frame)
        place = three_bytes(left // 2, top // 2, part.width - 1, part.height - 1, duration)
        parts += chunk(b"ANMF", place + b"\0" + encoded(part, quality))
    return b"RIFF" + struct.pack("<I", 4 + len(parts)) + b"WEBP" + parts


def main(folder: str, out: str, frames_per_second: str, most_bytes: str) -> None:
    """Writes the file, and fails if no quality makes it small enough."""
    frames = [Image.open(path).convert("RGB") for path in sorted(pathlib.Path(folder).glob("*.png"))]
    for quality in QUALITIES:
        file = animation(frames, quality, round(1000 / float(frames_per_second)))
        if len(file) <= int(most_bytes):
            pathlib.Path(out).write_bytes(file)
            width, height = frames[0].size
            print(f"{out}: {len(frames)} frames of {width}x{height} pixels, quality {quality}, {len(file)} bytes")
            return
    sys.exit(f"{out} would have {len(file)} bytes at quality {QUALITIES[-1]}; allowed are {most_bytes}")


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
