import os
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import OutputError
from pellucid.jobs.output import PICTURES, check_file, check_files, check_folder, save_array, save_bitmap, write


def srgb(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


@pytest.fixture
def picture():
    return np.random.default_rng(0).random((4, 6, 3)) * 1.5


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_float_formats_keep_the_linear_numbers(tmp_path, picture, suffix):
    path = tmp_path / f"picture{suffix}"
    save_array(picture, path)
    tolerance = 1e-6 if suffix == ".exr" else 0.01  # RGBE shares one exponent
    np.testing.assert_allclose(np.array(mi.Bitmap(str(path)))[..., :3], picture, atol=tolerance * 1.5, rtol=tolerance)


def test_png_has_the_srgb_curve_and_clips(tmp_path, picture):
    save_array(picture, tmp_path / "picture.png")
    expected = np.clip(255 * srgb(np.minimum(picture, 1)), 0, 255)
    found = np.array(mi.Bitmap(str(tmp_path / "picture.png"))).astype(float)
    assert np.abs(found - expected).max() <= 1  # Mitsuba dithers


def test_jpg_is_written(tmp_path):
    save_array(np.full((16, 16, 3), 0.5), tmp_path / "picture.jpg")
    found = np.array(mi.Bitmap(str(tmp_path / "picture.jpg"))).astype(float)
    assert np.abs(found - 255 * srgb(0.5)).max() <= 3


def test_extra_channels_stay_out_of_png_and_in_exr(tmp_path):
    data = np.random.default_rng(1).random((4, 5, 6)).astype(np.float32)
    names = ["R", "G", "B", "exitance.R", "exitance.G", "exitance.B"]
    bitmap = mi.Bitmap(data, channel_names=names)
    save_bitmap(bitmap, tmp_path / "all.exr")
    save_bitmap(bitmap, tmp_path / "first.png")
    channels = [field.name for field in mi.Bitmap(str(tmp_path / "all.exr")).struct_()]
    assert sorted(channels) == sorted(names)
    found = np.array(mi.Bitmap(str(tmp_path / "first.png"))).astype(float)
    assert np.abs(found - 255 * srgb(data[..., :3])).max() <= 1


def test_a_failed_writer_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")

    def interrupted(beside):
        beside.write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(path, interrupted)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_told_in_one_line(tmp_path):
    def full(beside):
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match=r"^'.*picture.png' could not be written: No space left on device\.$"):
        write(tmp_path / "picture.png", full)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("picture.tiff", "'.tiff' is no kind of file"),
        ("picture.pgn", "did you mean '.png'"),
        ("picture", "has no extension"),
        ("missing/picture.png", "create it first"),
        ("file.txt/picture.png", "is a file, not a folder"),
        ("folder.png", "is a folder"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, name, expected):
    (tmp_path / "file.txt").write_text("")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OutputError, match=expected.replace("?", r"\?")):
        check_file(tmp_path / name)


def test_what_is_no_ordinary_file_is_left_alone(tmp_path):
    """A fifo was replaced by a picture, and so was a link that leads back to itself."""
    os.mkfifo(tmp_path / "fifo.png")
    (tmp_path / "loop.png").symlink_to("loop.png")
    with pytest.raises(OutputError, match="no ordinary file"):
        check_file(tmp_path / "fifo.png")
    with pytest.raises(OutputError, match="leads back to itself"):
        check_file(tmp_path / "loop.png")


def test_protected_files_and_folders_are_refused(tmp_path, monkeypatch):
    # Rights do not bind root, so the refusal of the system is played.
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(OutputError, match="write-protected"):
        check_file(path)

    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.NamedTemporaryFile", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        check_folder(tmp_path)


def test_checking_leaves_nothing_behind(tmp_path):
    check_file(tmp_path / "picture.exr")
    check_folder(tmp_path / "new" / "folder", create=True)
    assert [p.name for p in tmp_path.iterdir()] == ["new"]


@pytest.mark.parametrize("suffix", PICTURES)
def test_names_that_are_no_text(tmp_path, picture, suffix):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe")) / f"\udcff{suffix}"
    path.parent.mkdir()
    save_array(picture, check_file(path))
    assert path.stat().st_size > 100


def test_the_longest_name_and_one_that_is_too_long(tmp_path, picture):
    path = tmp_path / ("n" * 251 + ".png")
    save_array(picture, check_file(path))
    assert path.is_file()
    with pytest.raises(OutputError, match="cannot be written: File name too long"):
        check_file(tmp_path / ("n" * 252 + ".png"))


def test_what_a_link_leads_to_is_written(tmp_path, picture):
    (tmp_path / "far").mkdir()
    link, target = tmp_path / "link.png", tmp_path / "far" / "target.png"
    link.symlink_to(target)
    for _ in range(2):  # first it leads to nothing, then to a picture
        save_array(picture, check_file(link))
        assert link.is_symlink() and mi.Bitmap(str(target)).width() == 6
    link.unlink()
    link.symlink_to(tmp_path / "nowhere" / "target.png")
    with pytest.raises(OutputError, match="create it first"):
        check_file(link)


def test_one_file_named_twice(tmp_path):
    (tmp_path / "link.png").symlink_to(tmp_path / "a.png")
    check_files([tmp_path / "a.png", tmp_path / "a.exr"])
    for other in ("a.png", "link.png", "../" + tmp_path.name + "/a.png"):
        with pytest.raises(OutputError, match="are one file"):
            check_files([tmp_path / "a.png", tmp_path / other])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device to write to")
def test_a_full_disk_is_told_in_our_words(tmp_path, picture, monkeypatch):
    def write_to_full(self, data):
        with open("/dev/full", "wb", buffering=0) as full:
            full.write(data)

    monkeypatch.setattr(Path, "write_bytes", write_to_full)
    with pytest.raises(OutputError, match=r"^'.*picture.exr' could not be written: No space left on device\.$"):
        save_array(picture, tmp_path / "picture.exr")
