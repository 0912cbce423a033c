import base64
import html
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import torch

from edit3r.geometry.harmonics import colour_to_dc
from edit3r.io.viewer import save_viewer
from edit3r.reporting import Report, collecting
from edit3r.types import Cameras, Gaussians


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
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]]).repeat(1, count, 1, 1)
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
    data, n = base64.b64decode(scripts.get("data", "")), meta["count"]
    assert len(data) == 23 * n
    arrays = {
        "means": np.frombuffer(data, "<f4", 3 * n).reshape(n, 3),
        "colours": np.frombuffer(data, "u1", 4 * n, 12 * n).reshape(n, 4) / 255,
        "scales": np.exp(meta["scaleLow"] + meta["scaleStep"] * np.frombuffer(data, "u1", 3 * n, 16 * n).reshape(n, 3)),
        "quats": np.frombuffer(data, "i1", 4 * n, 19 * n).reshape(n, 4) / 127,
    }
    return meta, arrays


def test_page_holds_the_scene_within_its_stated_precision(tmp_path):
    gaussians = scene()
    save_viewer(tmp_path / "v.html", gaussians, cameras())
    _, arrays = opened(tmp_path / "v.html")
    np.testing.assert_array_equal(arrays["means"], gaussians.means[0].numpy())
    np.testing.assert_allclose(arrays["scales"], gaussians.scales[0].numpy(), rtol=0.5 * np.log(1000) / 255 + 1e-3)
    quats = torch.nn.functional.normalize(gaussians.quats[0], dim=-1).numpy()
    np.testing.assert_allclose(arrays["quats"], quats, atol=0.5 / 127 + 1e-6)
    colours = torch.cat((gaussians.harmonics[0, :, 0] * 0.28209479 + 0.5, gaussians.opacities[0][:, None]), 1)
    np.testing.assert_allclose(arrays["colours"], colours.numpy(), atol=0.5 / 255 + 1e-6)


def test_page_needs_no_network(tmp_path):
    save_viewer(tmp_path / "v.html", scene(), cameras())
    page = tmp_path.joinpath("v.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|//cdn|import\s*\(|<link|src=", page)
    assert "__" not in Scripts(page).found["code"]


def test_page_of_131072_gaussians_stays_under_5_megabytes(tmp_path):
    save_viewer(tmp_path / "v.html", scene(131072), cameras())
    assert (tmp_path / "v.html").stat().st_size < 5e6


def test_page_starts_at_the_first_camera_and_stands_upright(tmp_path):
    save_viewer(tmp_path / "v.html", scene(), cameras(), names=["left", "right"])
    meta, _ = opened(tmp_path / "v.html")
    assert [view["name"] for view in meta["views"]] == ["left", "right"]
    assert meta["views"][0]["c2w"] == torch.eye(4).tolist()
    assert meta["views"][0]["lens"] == pytest.approx(dict(fx=360, fy=360, cx=200, cy=150, width=400, height=300))
    assert meta["up"] == [0, -1, 0]
    assert 4 < meta["distance"] < 6


def test_text_cannot_break_out_of_the_page(tmp_path):
    evil = '</script><script>alert("1")</script><b>'
    save_viewer(tmp_path / "v.html", scene(), cameras(), names=[evil, evil], title=evil, subtitle=evil)
    page = (tmp_path / "v.html").read_text(encoding="utf-8")
    assert 'alert("1")' not in page
    meta, _ = opened(tmp_path / "v.html")
    assert meta["title"] == evil


@pytest.mark.parametrize("title", ["__META__", "__DATA__", "__TITLE____META__</script>", "\\1 __DATA__ \udcff"])
def test_a_title_is_never_taken_for_a_place_to_fill(tmp_path, title):
    save_viewer(tmp_path / "a.html", scene(), cameras(), title=title)
    meta, _ = opened(tmp_path / "a.html")
    assert meta["title"] == title and meta["count"] == 200
    shown = re.search("<title>(.*?)</title>", (tmp_path / "a.html").read_text(encoding="utf-8"))[1]
    assert html.unescape(shown) == title.replace("\udcff", "?")


def test_colours_are_those_seen_from_the_view_each_came_from(tmp_path):
    gaussians = scene(2, degree=1)
    gaussians.means[0] = torch.tensor([[1.0, 0, 5], [1.0, 0, 5]])
    gaussians.harmonics[0, :, 3] = 1.0  # the function -0.4886 x
    gaussians.view_index[1] = 1  # whose camera stands at x = 1: no change there
    save_viewer(tmp_path / "v.html", gaussians, cameras())
    _, arrays = opened(tmp_path / "v.html")
    plain = (gaussians.harmonics[0, :, 0] * 0.28209479 + 0.5).numpy()
    np.testing.assert_allclose(arrays["colours"][1, :3], plain[1], atol=0.003)
    expected = np.clip(plain[0] - 0.48860251 / 26**0.5, 0, 1)
    np.testing.assert_allclose(arrays["colours"][0, :3], expected, atol=0.003)


def test_too_many_gaussians_keep_the_most_visible_with_a_warning(tmp_path, monkeypatch):
    monkeypatch.setattr("edit3r.io.viewer.MOST_GAUSSIANS", 100)
    gaussians = scene(200)
    gaussians.opacities[0, ::2] = 0.005
    with collecting(Report()) as report:
        save_viewer(tmp_path / "v.html", gaussians, cameras())
    _, arrays = opened(tmp_path / "v.html")
    assert len(arrays["means"]) == 100 and "shows 100 of 200" in report.warnings[0]


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


def test_a_near_object_is_not_what_goes_first_where_there_are_too_many(tmp_path, monkeypatch):
    """Of one Gaussian per pixel, those of a near surface are smaller than those of a far one, and look as large."""
    monkeypatch.setattr("edit3r.io.viewer.MOST_GAUSSIANS", 100)
    depths = torch.cat((torch.full((100,), 2.0), torch.full((100,), 20.0)))
    near_looks_larger = torch.cat((torch.full((100,), 0.011), torch.full((100,), 0.01)))
    means = torch.stack((torch.zeros(200), torch.zeros(200), depths), 1)[None]
    scales = (near_looks_larger * depths)[None, :, None].expand(1, 200, 3)
    quats = torch.tensor([1.0, 0, 0, 0]).expand(1, 200, 4)
    save_viewer(
        tmp_path / "v.html", Gaussians(means, scales, quats, torch.ones(1, 200), torch.zeros(1, 200, 1, 3)), cameras(1)
    )
    _, arrays = opened(tmp_path / "v.html")
    assert len(arrays["means"]) == 100 and (arrays["means"][:, 2] == 2).all()
