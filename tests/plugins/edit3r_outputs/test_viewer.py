import base64
import html
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import torch

from edit3r.contract.interfaces import NamedObjects, SceneToWrite, SecondLook
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.loading.registry import build


def save_viewer(
    path, gaussians, cameras, before=None, looks=("after", "before"), **known
):
    """Write the page; `before` is the second look's colours."""
    if before is not None:
        known["second_look"] = lambda: SecondLook(before, looks)
    scene = SceneToWrite(gaussians, cameras, **known)
    build("writer", "viewer").write(path, scene)


def scene(count=200, degree=0, seed=0):
    generator = torch.Generator().manual_seed(seed)
    harmonics = torch.zeros(1, count, (degree + 1) ** 2, 3)
    harmonics[:, :, 0] = colour_to_dc(torch.rand(1, count, 3, generator=generator))
    return Gaussians(
        means=torch.randn(1, count, 3, generator=generator) + torch.tensor([0, 0, 5.0]),
        scales=10 ** (torch.rand(1, count, 3, generator=generator) * 3 - 4),
        quats=torch.randn(1, count, 4, generator=generator),
        opacities=torch.rand(1, count, generator=generator) * 0.9 + 0.1,
        harmonics=harmonics,
    )


def cameras(count=2):
    c2w = torch.eye(4).repeat(1, count, 1, 1)
    c2w[0, :, 0, 3] = torch.arange(count)
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]]).repeat(
        1, count, 1, 1
    )
    return Cameras(c2w, intrinsics, (300, 400))


class Scripts(HTMLParser):
    """Collects the text of script elements by their id, as a browser would cut them."""

    def __init__(self, text):
        super().__init__()
        self.found, self.current = {}, None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag == "script":
            self.current = dict(attributes).get("id", "code")

    def handle_endtag(self, tag):
        self.current = None

    def handle_data(self, data):
        if self.current:
            self.found[self.current] = self.found.get(self.current, "") + data


def opened(path):
    """(meta, arrays) of a page, unpacked as its own script does."""
    scripts = Scripts(path.read_text(encoding="utf-8")).found
    meta = json.loads(scripts["meta"])
    n, degree = meta["count"], meta["degree"]
    last = 17 + 3 * meta["before"] + 3 * ((degree + 1) ** 2 - 1)
    rows = last + 2 * ("named" in meta) + meta.get("unsure", False)
    planes = (
        np.frombuffer(zlib.decompress(base64.b64decode(scripts["data"])), "u1")
        .reshape(rows, n)
        .astype(np.int64)
    )
    summed = np.cumsum(planes, axis=1) % 256
    steps = np.cumsum(planes[:3] + 256 * planes[3:6], axis=1) % 65536
    x, y = steps[:2] / 32767.5 - 1
    z = 1 - abs(x) - abs(y)
    behind = z < 0
    x[behind], y[behind] = (
        (1 - abs(y[behind])) * np.where(x[behind] < 0, -1, 1),
        (1 - abs(x[behind])) * np.where(y[behind] < 0, -1, 1),
    )
    directions = np.stack((x, y, z), 1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    far = np.exp(meta["distanceLow"] + meta["distanceStep"] * steps[2])
    arrays = {
        "means": np.array(meta["eye"]) + far[:, None] * directions,
        "colours": meta["colourLow"] + meta["colourStep"] * summed[6:9].T,
        "opacities": planes[9] / 255,
        "scales": np.exp(meta["scaleLow"] + meta["scaleStep"] * summed[10:13].T),
        "quats": planes[13:17].astype("u1").view("i1").T / 127,
    }
    if meta["before"]:
        arrays["before"] = (
            meta["colourLow"]
            + meta["colourStep"] * ((planes[17:20] + summed[6:9]) % 256).T
        )
    harmonics = (
        planes[17 + 3 * meta["before"] : last].astype("u1").view("i1")
        * meta["harmonicsStep"]
    )
    arrays["harmonics"] = harmonics.T.reshape(n, len(harmonics) // 3, 3)
    if "named" in meta:
        arrays["places"] = planes[last] + 256 * planes[last + 1]
    if "unsure" in meta:
        arrays["unsure"] = planes[-1] / 255
    return meta, arrays


def test_page_holds_the_scene_within_its_stated_precision(tmp_path):
    gaussians = scene()
    gaussians.means[0, :50] -= torch.tensor([0, 0, 12.0])  # behind the cameras too
    save_viewer(tmp_path / "v.html", gaussians, cameras())
    meta, arrays = opened(tmp_path / "v.html")
    offsets = gaussians.means[0].numpy() - np.array(meta["eye"])
    wrong = np.linalg.norm(
        arrays["means"] - gaussians.means[0].numpy(), axis=1
    ) / np.linalg.norm(offsets, axis=1)
    assert wrong.max() < 1e-4  # of the distance: 1/20 of a pixel at 512 pixels
    np.testing.assert_allclose(
        arrays["scales"],
        gaussians.scales[0].numpy(),
        rtol=0.5 * np.log(1000) / 255 + 1e-3,
    )
    quats = torch.nn.functional.normalize(gaussians.quats[0], dim=-1).numpy()
    np.testing.assert_allclose(arrays["quats"], quats, atol=0.5 / 127 + 1e-6)
    colours = (gaussians.harmonics[0, :, 0] * 0.28209479 + 0.5).numpy()
    np.testing.assert_allclose(arrays["colours"], colours, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(
        arrays["opacities"], gaussians.opacities[0].numpy(), atol=0.5 / 255 + 1e-6
    )


@pytest.mark.parametrize("degree", [1, 3, 4])
@pytest.mark.parametrize("size", [0.1, 3.0])
def test_page_holds_the_harmonics(tmp_path, degree, size):
    gaussians = scene(50, degree)
    gaussians.harmonics[:, :, 1:] = size * torch.randn(
        gaussians.harmonics[:, :, 1:].shape
    )
    save_viewer(tmp_path / "v.html", gaussians, cameras(), before=torch.rand(50, 3))
    meta, arrays = opened(tmp_path / "v.html")
    expected = gaussians.harmonics[0, :, 1:].numpy()
    np.testing.assert_allclose(
        arrays["harmonics"], expected, atol=0.51 * max(0.01, abs(expected).max() / 127)
    )
    assert meta["degree"] == degree


def test_page_holds_a_second_look_for_the_same_gaussians(tmp_path):
    gaussians, before = scene(), torch.rand(200, 3)
    gaussians.opacities[0, ::2] = 0.001  # never drawn: not in the page
    save_viewer(tmp_path / "v.html", gaussians, cameras(), before=before)
    _, arrays = opened(tmp_path / "v.html")
    np.testing.assert_allclose(
        arrays["before"], before[1::2].numpy(), atol=0.5 / 255 + 1e-6
    )


def test_page_holds_which_object_a_gaussian_belongs_to_and_how_unsure_it_is(tmp_path):
    index = torch.arange(400) % 300 - 1
    unsure = torch.rand(1, 400)
    gaussians = replace(scene(400), object_index=index, uncertainty=unsure)
    names = {f"</script>{number}": number for number in range(298, -1, -1)}
    save_viewer(tmp_path / "v.html", gaussians, cameras(), objects=NamedObjects(names))
    meta, arrays = opened(tmp_path / "v.html")
    assert meta["named"] == list(names)
    np.testing.assert_array_equal(arrays["places"], np.where(index < 0, 0, 299 - index))
    np.testing.assert_allclose(
        arrays["unsure"], unsure[0].numpy(), atol=0.5 / 255 + 1e-6
    )


def test_a_scene_without_objects_or_numbers_pays_nothing_for_them(tmp_path):
    save_viewer(tmp_path / "v.html", scene(), cameras(), objects=NamedObjects({}, "go"))
    meta, arrays = opened(tmp_path / "v.html")
    assert not {"named", "command", "unsure"} & {*meta}
    assert not {"places", "unsure"} & {*arrays}


def test_page_needs_no_network(tmp_path):
    save_viewer(tmp_path / "v.html", scene(), cameras())
    page = tmp_path.joinpath("v.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|//cdn|import\s*\(|<link|src=", page)
    assert "__" not in Scripts(page).found["code"]


def test_page_of_the_least_orderly_scene_stays_under_28_bytes_a_gaussian(tmp_path):
    """380,000 make 10 MB with a second look; real scenes, whose neighbours are alike, need a
    third.
    """
    save_viewer(
        tmp_path / "v.html", scene(50_000), cameras(), before=torch.rand(50_000, 3)
    )
    assert (tmp_path / "v.html").stat().st_size < 28 * 50_000


def test_page_starts_at_the_first_camera_and_stands_upright(tmp_path):
    save_viewer(tmp_path / "v.html", scene(), cameras(), names=["left", "right"])
    meta, _ = opened(tmp_path / "v.html")
    assert [view["name"] for view in meta["views"]] == ["left", "right"]
    assert meta["views"][0]["c2w"] == torch.eye(4).tolist()
    (fx, _, cx), (_, fy, cy), _ = meta["views"][0]["K"]
    assert meta["size"] == [300, 400]
    assert (fx, fy, cx, cy) == pytest.approx((360, 360, 200, 150))
    assert meta["up"] == [0, -1, 0]
    assert 4 < meta["distance"] < 6


def test_text_cannot_break_out_of_the_page(tmp_path):
    evil = '</script><script>alert("1")</script><b>'
    save_viewer(
        tmp_path / "v.html",
        scene(),
        cameras(),
        names=[evil, evil],
        title=evil,
        subtitle=evil,
    )
    page = (tmp_path / "v.html").read_text(encoding="utf-8")
    assert 'alert("1")' not in page
    meta, _ = opened(tmp_path / "v.html")
    assert meta["title"] == evil


@pytest.mark.parametrize(
    "title",
    ["__META__", "__DATA__", "__TITLE____META__</script>", "\\1 __DATA__ \udcff"],
)
def test_a_title_is_never_taken_for_a_place_to_fill(tmp_path, title):
    save_viewer(tmp_path / "a.html", scene(), cameras(), title=title)
    meta, _ = opened(tmp_path / "a.html")
    assert meta["title"] == title and meta["count"] == 200
    shown = re.search(
        "<title>(.*?)</title>", (tmp_path / "a.html").read_text(encoding="utf-8")
    )[1]
    assert html.unescape(shown) == title.replace("\udcff", "?")


def test_nothing_that_is_seen_is_left_out_however_many_there_are(tmp_path, monkeypatch):
    monkeypatch.setattr("edit3r_outputs.viewer.EASY_GAUSSIANS", 50)
    gaussians = scene(200)
    gaussians.opacities[0, ::2] = 0.003  # below 1/255 nothing is drawn
    with collecting(Report()) as report:
        save_viewer(tmp_path / "v.html", gaussians, cameras())
    _, arrays = opened(tmp_path / "v.html")
    assert len(arrays["means"]) == 100 and "holds 100 Gaussians" in report.warnings[0]


def test_empty_and_invisible_scenes_still_open(tmp_path):
    gaussians = scene(5)
    gaussians.opacities[:] = 0
    save_viewer(tmp_path / "v.html", gaussians, cameras(1))
    meta, _ = opened(tmp_path / "v.html")
    assert meta["count"] == 0 and meta["distance"] == 1


def test_same_scene_gives_the_same_page(tmp_path):
    for name in ("a.html", "b.html"):
        save_viewer(tmp_path / name, scene(), cameras())
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
