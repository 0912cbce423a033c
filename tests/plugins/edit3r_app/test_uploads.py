"""Uploads: what is no photo, too much or too large is refused in a sentence and leaves nothing."""

import asyncio
import io
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from edit3r_app import uploads
from edit3r_app.jobs import JobsFolder
from PIL import Image

from edit3r.contract.errors import InputError


def picture(form="PNG", size=(32, 24), seed=0, **options):
    content = io.BytesIO()
    pixels = np.random.default_rng(seed).integers(
        0, 255, (*size[::-1], 3), dtype=np.uint8
    )
    Image.fromarray(pixels).save(content, form, **options)
    return content.getvalue()


def chunk(kind, content):
    return (
        struct.pack(">I", len(content))
        + kind
        + content
        + struct.pack(">I", zlib.crc32(kind + content))
    )


def bomb(width=30_000, height=30_000):
    """A PNG of 900 megapixels in a few kilobytes."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0" * 10**6))
        + chunk(b"IEND", b"")
    )


HOSTILE = {
    "html as png": ("x.png", b"<html><script>alert(1)</script></html>"),
    "html": ("x.html", b"<html></html>"),
    "svg": ("x.svg", b'<svg xmlns="http://www.w3.org/2000/svg" onload="alert(1)"/>'),
    "svg as jpg": ("x.jpg", b'<svg xmlns="http://www.w3.org/2000/svg"/>'),
    "eps as jpg": (
        "x.jpg",
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(touch /tmp/edit3r-escaped) run\n",
    ),
    "pdf as png": ("x.png", b"%PDF-1.4\n%\xe2\xe3"),
    "zip as png": ("x.png", b"PK\x03\x04" + bytes(100)),
    "program as jpg": ("x.jpg", b"\x7fELF" + bytes(100)),
    "pickle as png": (
        "x.png",
        b"\x80\x04cos\nsystem\n(S'touch /tmp/edit3r-escaped'\ntR.",
    ),
    "empty": ("x.png", b""),
    "one byte": ("x.png", b"\x89"),
    "cut off png": ("x.png", picture()[:200]),
    "cut off jpeg": ("x.jpg", picture("JPEG")[:300]),
    "zip bomb png": ("x.png", bomb()),
    "text bomb png": (
        "x.png",
        picture()[:33]
        + chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(10**7)))
        + picture()[33:],
    ),
    "no suffix": ("x", picture()),
    "program by name": ("x.png.exe", picture()),
    "null in the name": ("x.png\0.sh", picture()),
    "playlist": ("x.m3u8", b"#EXTM3U\nfile:///etc/passwd"),
    "playlist as video": ("x.mp4", b"#EXTM3U\nfile:///etc/passwd"),
    "video that is none": ("x.mp4", b"\0\0\0\x18ftypisom" + bytes(200)),
    "heif without end": ("x.heic", b"\0\0\0\x18ftypheic" + bytes(40)),
    "nothing at all": ("", b""),
}


def send(folder, scene, name, content, size=None):
    async def chunks():
        for start in range(0, len(content), 1000):
            yield content[start : start + 1000]

    return asyncio.run(uploads.receive(folder, scene, name, size, chunks()))


@pytest.fixture
def folder(tmp_path):
    return JobsFolder(tmp_path / "jobs")


@pytest.fixture
def scene(folder):
    return folder.new_scene("bear")


def everything(folder):
    return sorted(
        str(path.relative_to(folder.root))
        for path in folder.root.rglob("*")
        if path.is_file()
    )


@pytest.mark.parametrize("case", HOSTILE)
def test_what_is_no_photo_is_refused_in_one_sentence_and_leaves_nothing(
    case, folder, scene
):
    name, content = HOSTILE[case]
    with pytest.raises(InputError) as refused:
        send(folder, scene, name, content)
    sentence = str(refused.value)
    assert (
        sentence.endswith(".")
        and len(sentence) < 400
        and "upload-" not in sentence
        and str(folder.root) not in sentence
    )
    assert everything(folder) == []


PATHS = [
    "../../evil.png",
    "/etc/passwd.png",
    "..\\..\\evil.png",
    "C:\\evil.png",
    ".bashrc.png",
    "con.png",
    "a" * 400 + ".png",
    "<b>x</b>.png",
    "%2e%2e%2fevil.png",
    "a\nb.png",
]


@pytest.mark.parametrize("name", PATHS)
def test_names_never_become_paths(name, folder, scene, tmp_path):
    kept = send(folder, scene, name, picture())
    assert (
        kept.parent == folder.root / scene / "images"
        and kept.suffix == ".png"
        and not kept.name.startswith(".")
    )
    assert everything(folder) == [str(kept.relative_to(folder.root))]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["jobs"]


@pytest.mark.parametrize(
    ("photo", "title"),
    [
        ("IMG_2034.JPG", "scene"),
        ("000.jpg", "scene"),
        ("PXL_20240102_1.jpg", "scene"),
        ("my cat 2.png", "my cat 2"),
        ("dscf.png", "scene"),
        ("", "scene"),
    ],
)
def test_a_set_is_called_by_its_photo_where_no_camera_named_that(photo, title):
    assert uploads.title_of(photo) == title


def test_a_claim_of_a_gigabyte_is_refused_before_anything_is_read(folder, scene):
    with pytest.raises(InputError, match="1,024 MB; photos of at most 100 MB"):
        send(folder, scene, "x.png", b"", size=2**30)


def test_a_body_that_is_longer_than_it_said_is_refused_on_the_way(
    folder, scene, monkeypatch
):
    monkeypatch.setattr(uploads, "MAX_BYTES", 2000)
    with pytest.raises(InputError, match="photos of at most"):
        send(folder, scene, "x.png", picture(size=(200, 200)), size=10)
    assert everything(folder) == []


@pytest.mark.slow
def test_more_files_than_a_scene_takes_end_at_the_limit(folder, scene):
    refused = 0
    for seed in range(70):
        try:
            send(folder, scene, f"{seed}.png", picture(size=(8, 8), seed=seed))
        except InputError as error:
            assert "at most 60 photos" in str(error)
            refused += 1
    assert refused == 10 and len(folder.photos(scene)) == 60


def test_photos_keep_their_bytes_and_equal_names_are_numbered(folder, scene):
    first, second = picture("JPEG", seed=1), picture("JPEG", seed=2)
    kept = [send(folder, scene, "a.JPG", content) for content in (first, second, first)]
    assert [path.name for path in kept] == ["a.jpg", "a-2.jpg", "a.jpg"]
    assert kept[0].read_bytes() == first and kept[1].read_bytes() == second


def test_photos_of_one_name_that_come_at_once_are_all_kept(folder, scene):
    contents = [picture(seed=seed) for seed in range(24)]
    with ThreadPoolExecutor(24) as sending:
        kept = list(
            sending.map(lambda content: send(folder, scene, "a.png", content), contents)
        )
    assert len(set(kept)) == 24
    assert [file.read_bytes() for file in kept] == contents


def test_a_photo_that_is_taken_out_twice_takes_no_other_with_it(folder, scene):
    for seed, name in enumerate("abc"):
        send(folder, scene, f"{name}.png", picture(seed=seed))
    uploads.remove(folder, scene, "a")
    uploads.remove(folder, scene, "a")
    assert list(folder.photos(scene)) == ["b", "c"]


def test_a_finished_run_takes_no_photos(folder, scene):
    (folder.root / scene / "run.json").write_text("{}")
    with pytest.raises(InputError, match="begin with new photos"):
        send(folder, scene, "a.png", picture())


def test_a_set_that_holds_no_photo_can_be_discarded_and_no_other(folder, scene):
    send(folder, scene, "a.png", picture())
    uploads.discard(folder, scene)
    assert len(folder.photos(scene)) == 1
    uploads.remove(folder, scene, "a")
    uploads.discard(folder, scene)
    assert not (folder.root / scene).exists()


def test_a_set_that_leads_elsewhere_takes_no_photos_and_loses_none(folder, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    Image.new("RGB", (8, 6)).save(theirs / "a.png")
    (folder.root / "set").mkdir()
    (folder.root / "set/images").symlink_to(theirs)
    with pytest.raises(InputError, match="leads out of the jobs folder"):
        uploads.remove(folder, "set", "a")
    draft = tmp_path / "draft"
    Image.new("RGB", (8, 6), "red").save(draft, "PNG")
    with pytest.raises(InputError, match="leads out of the jobs folder"):
        uploads.accept(folder, "set", "b.png", draft)
    assert [file.name for file in theirs.iterdir()] == ["a.png"]


@pytest.mark.slow
def test_of_a_video_frames_are_kept_as_photos(folder, scene, tmp_path):
    from edit3r_outputs.video import save_video

    wide = (
        np.random.default_rng(0)
        .integers(0, 255, (60, 300, 3), dtype=np.uint8)
        .repeat(4, 0)
        .repeat(4, 1)
    )
    save_video(
        tmp_path / "pan.webm",
        [wide[:, 16 * step : 16 * step + 320] for step in range(20)],
        fps=10,
    )
    kept = send(folder, scene, "pan.webm", (tmp_path / "pan.webm").read_bytes())
    assert kept.name == "pan-00.png" and 2 <= len(folder.photos(scene)) <= 8
    assert not list(folder.private.iterdir())
