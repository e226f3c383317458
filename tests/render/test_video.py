import os
import signal
import subprocess
import sys
import textwrap

import av
import numpy as np
import pytest

from gsrain_engine.render.video import ErrorCapturingFile, VideoWriter, can_write_videos


def frames(count=12, width=64, height=48):
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    for k in range(count):
        yield np.stack([(x * 4 + 5 * k) % 256, y * 5 % 256, np.full_like(x, 20 * k % 256)], axis=-1).astype(np.uint8)


def decode(path):
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


@pytest.mark.parametrize(("suffix", "codec"), [(".mp4", None), (".webm", None), (".mp4", "av1"), (".webm", "av1")])
def test_video_plays_and_is_the_same_every_time(tmp_path, suffix, codec):
    paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for path in paths:
        with VideoWriter(path, 64, 48, 30.0, codec=codec) as video:
            for pixels in frames():
                video.write(pixels)
    shown = decode(paths[0])
    assert len(shown) == 12
    assert np.abs(shown[3].astype(int) - list(frames())[3]).mean() < 12
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with av.open(str(paths[0])) as container:
        assert float(container.streams.video[0].average_rate) == pytest.approx(30.0)


def test_ctrl_c_is_heard_while_the_file_is_written(tmp_path, monkeypatch):
    path, written = tmp_path / "stopped.mp4", ErrorCapturingFile.write
    pressed = []

    def write(file, data):
        if not pressed:
            pressed.append(file.tell())
            signal.raise_signal(signal.SIGINT)
        return written(file, data)

    monkeypatch.setattr(ErrorCapturingFile, "write", write)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), VideoWriter(path, 64, 48, 30.0) as video:
            for pixels in frames(100):
                video.write(pixels)
    finally:
        signal.signal(signal.SIGINT, before)
    assert pressed
    assert 0 < len(decode(path)) < 100


def test_a_killed_video_keeps_what_was_written(tmp_path):
    path = tmp_path / "killed.mp4"
    script = textwrap.dedent(f"""
        import os, signal
        import numpy as np
        from pathlib import Path
        from gsrain_engine.render.video import VideoWriter
        video = VideoWriter(Path({str(path)!r}), 64, 48, 30.0)
        rng = np.random.default_rng(0)
        for _ in range(240):
            video.write(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
        os.kill(os.getpid(), signal.SIGKILL)
    """)
    done = subprocess.run([sys.executable, "-c", script], env={**os.environ}, timeout=120, check=False)
    assert done.returncode == -signal.SIGKILL
    assert len(decode(path)) >= 120


@pytest.mark.parametrize(
    ("name", "size", "codec", "words"),
    [
        ("a.mp4", (63, 48), None, "even"), ("a.gif", (64, 48), None, ".mp4"),
        ("a.webm", (64, 48), "h264", "vp9 or av1"), ("no PyAV.mp4", (64, 48), None, "PyAV"),
    ],
)  # fmt: skip
def test_what_cannot_be_encoded_is_refused(tmp_path, monkeypatch, name, size, codec, words):
    assert can_write_videos()
    if "PyAV" in name:
        monkeypatch.setitem(sys.modules, "av", None)
        assert not can_write_videos()
    with pytest.raises(ValueError, match=words):
        VideoWriter(tmp_path / name, *size, 30.0, codec=codec)
    assert list(tmp_path.iterdir()) == []
