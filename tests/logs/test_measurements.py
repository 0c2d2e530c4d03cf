"""Pictures of logs: what a few bytes may not ask for."""

import subprocess
import sys
from pathlib import Path
from struct import pack
from zlib import compress, crc32

import pytest

CODE = """
import contextlib, sys
import numpy as np
from offpiste.cli import main
with contextlib.suppress(SystemExit):
    main(["--version"])
from offpiste.logs.measurements import decoded_picture
picture = decoded_picture(np.fromfile(sys.argv[1], np.uint8), grey=True)
print("" if picture is None else picture.shape)
"""


def black_png(side: int) -> bytes:
    """A sound PNG of one bit a pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return pack(">I", len(data)) + kind + data + pack(">I", crc32(kind + data))

    rows = compress(bytes((1 + -(-side // 8)) * side), 1)
    head = chunk(b"IHDR", pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("side", "shape"), [(64, "(64, 64)"), (12_000, "")])
def test_a_small_file_cannot_ask_for_a_picture_beyond_the_limit(tmp_path: Path, side: int, shape: str) -> None:
    (tmp_path / "black.png").write_bytes(black_png(side))
    done = subprocess.run([sys.executable, "-c", CODE, str(tmp_path / "black.png")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].strip() == shape
