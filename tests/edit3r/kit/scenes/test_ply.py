from dataclasses import replace

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.scenes.ply import load_ply, read_header, save_ply


def scene(count=50, degree=0, seed=0, view_index=None):
    generator = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=torch.randn(1, count, 3, generator=generator),
        scales=torch.rand(1, count, 3, generator=generator) * 0.1 + 1e-4,
        quats=torch.nn.functional.normalize(
            torch.randn(1, count, 4, generator=generator), dim=-1
        ),
        opacities=torch.rand(1, count, generator=generator) * 0.98 + 0.01,
        harmonics=torch.randn(1, count, (degree + 1) ** 2, 3, generator=generator),
        view_index=view_index,
    )


def assert_same(a, b):
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        torch.testing.assert_close(
            getattr(a, name), getattr(b, name), rtol=1e-5, atol=1e-6, msg=name
        )


@pytest.mark.parametrize("degree", range(5))
def test_every_degree_comes_back(tmp_path, degree):
    gaussians = scene(degree=degree)
    edit3r.save_ply(tmp_path / "a.ply", gaussians)
    loaded = edit3r.load_ply(tmp_path / "a.ply")
    assert loaded.degree == degree
    assert_same(loaded, gaussians)


@pytest.mark.parametrize("degree", range(4))
def test_independent_reader_sees_the_same_scene(tmp_path, degree):
    gsply = pytest.importorskip("gsply")
    gaussians = scene(degree=degree)
    save_ply(tmp_path / "a.ply", gaussians)
    read = gsply.plyread(str(tmp_path / "a.ply"))

    def same(theirs, ours):
        np.testing.assert_allclose(
            np.asarray(theirs), ours[0].numpy(), rtol=1e-5, atol=1e-5
        )

    same(read.means, gaussians.means)
    same(read.scales, gaussians.scales.log())
    same(read.opacities, torch.logit(gaussians.opacities))
    same(read.quats, gaussians.quats)
    same(read.sh0, gaussians.harmonics[:, :, 0])
    if degree:
        same(read.shN, gaussians.harmonics[:, :, 1:])


def test_columns_stand_in_the_order_viewers_expect(tmp_path):
    gaussians = scene(1, degree=1)
    save_ply(tmp_path / "a.ply", gaussians)
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert any("OpenCV axes" in line for line in lines)
    names = [line.split()[2] for line in lines if line.startswith("property float")]
    rest = [f"f_rest_{i}" for i in range(9)]
    scales, quats = [f"scale_{i}" for i in range(3)], [f"rot_{i}" for i in range(4)]
    first = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names == [*first, *rest, "opacity", *scales, *quats]
    row = dict(zip(names, np.frombuffer(body, "<f4")))
    assert row["nx"] == row["ny"] == row["nz"] == 0
    # Channel-major: all higher harmonics of red first.
    expected = gaussians.harmonics[0, 0, 1:].T.reshape(-1)
    np.testing.assert_array_equal([row[name] for name in rest], expected.numpy())


def test_same_gaussians_give_the_same_bytes(tmp_path):
    for name in ("a.ply", "b.ply"):
        save_ply(tmp_path / name, scene(degree=2))
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_opacities_zero_and_one_and_scale_zero_stay_finite(tmp_path):
    gaussians = scene(2)
    gaussians.opacities[0] = torch.tensor([0.0, 1.0])
    gaussians.scales[0, 0] = 0
    save_ply(tmp_path / "a.ply", gaussians)
    body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[2]
    assert np.isfinite(np.frombuffer(body, "<f4")).all()
    loaded = load_ply(tmp_path / "a.ply")
    torch.testing.assert_close(loaded.opacities, gaussians.opacities, rtol=0, atol=2e-7)
    assert loaded.scales[0, 0].max() < 1e-30


def test_view_index_comes_back_from_the_header(tmp_path):
    index = torch.tensor([0] * 20 + [2] * 10 + [-1] * 5 + [1] * 15)
    save_ply(tmp_path / "a.ply", scene(view_index=index))
    assert torch.equal(load_ply(tmp_path / "a.ply").view_index, index)


def test_objects_are_one_more_property_that_comes_back(tmp_path):
    plain = scene(degree=1)
    index = torch.arange(50) % 3 - 1
    save_ply(tmp_path / "plain.ply", plain)
    save_ply(tmp_path / "a.ply", replace(plain, object_index=index))
    assert torch.equal(load_ply(tmp_path / "a.ply").object_index, index)
    assert load_ply(tmp_path / "plain.ply").object_index is None
    assert b"object_index" not in (tmp_path / "plain.ply").read_bytes()


def test_uncertainty_is_one_more_property_that_comes_back(tmp_path):
    number = torch.linspace(0, 1, 50)[None]
    save_ply(tmp_path / "plain.ply", scene())
    save_ply(tmp_path / "a.ply", replace(scene(), uncertainty=number))
    loaded = load_ply(tmp_path / "a.ply")
    assert torch.equal(loaded.uncertainty, number)
    save_ply(tmp_path / "again.ply", replace(loaded, uncertainty=None))
    assert (tmp_path / "again.ply").read_bytes() == (
        tmp_path / "plain.ply"
    ).read_bytes()


def test_uncertainty_of_a_strange_file_lies_between_0_and_1(tmp_path):
    save_ply(tmp_path / "a.ply", replace(scene(3), uncertainty=torch.zeros(1, 3)))
    head, end, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    table = np.frombuffer(body, "<f4").reshape(3, -1).copy()
    table[:, -1] = [np.nan, -7, 1e30]
    (tmp_path / "a.ply").write_bytes(head + end + table.tobytes())
    assert load_ply(tmp_path / "a.ply").uncertainty.tolist() == [[1, 0, 1]]


@pytest.mark.parametrize(
    "more",
    [
        {"object_index": torch.arange(50)},
        {"uncertainty": torch.rand(1, 50)},
        {"object_index": torch.arange(50), "uncertainty": torch.rand(1, 50)},
    ],
)
def test_other_programs_pass_over_further_properties(tmp_path, more):
    gsply = pytest.importorskip("gsply")
    theirs = []
    for gaussians in (scene(), replace(scene(), **more)):
        save_ply(tmp_path / "a.ply", gaussians)
        theirs.append(gsply.plyread(str(tmp_path / "a.ply")))
    for name in ("means", "scales", "quats", "opacities", "sh0"):
        assert np.array_equal(*(getattr(read, name) for read in theirs))


def test_what_is_no_object_is_none(tmp_path):
    save_ply(
        tmp_path / "a.ply", replace(scene(4), object_index=torch.tensor([3, 1, 2, 0]))
    )
    content = (tmp_path / "a.ply").read_bytes()
    head, end, body = content.partition(b"end_header\n")
    table = np.frombuffer(body, "<f4").reshape(4, -1).copy()
    table[:3, -1] = [np.nan, -7, 1e30]
    (tmp_path / "a.ply").write_bytes(head + end + table.tobytes())
    assert load_ply(tmp_path / "a.ply").object_index.tolist() == [-1, -1, -1, 0]


def test_view_index_in_many_runs_is_not_kept(tmp_path):
    save_ply(tmp_path / "a.ply", scene(1000, view_index=torch.arange(1000) % 2))
    assert (load_ply(tmp_path / "a.ply").view_index == -1).all()


def test_degree_can_be_cut_for_viewers(tmp_path):
    gaussians = scene(degree=4)
    with collecting(Report()) as report:
        save_ply(tmp_path / "a.ply", gaussians)
        assert "harmonics of degree 4" in report.warnings[0]
        save_ply(tmp_path / "b.ply", gaussians, degree=3)
        assert len(report.warnings) == 1
    loaded = load_ply(tmp_path / "b.ply")
    torch.testing.assert_close(loaded.harmonics, gaussians.harmonics[:, :, :16])


def test_comments_stay_on_one_ascii_line(tmp_path):
    save_ply(
        tmp_path / "a.ply",
        scene(),
        comment_lines=["prompt: paint\nend_header\nit grün"],
    )
    header = (tmp_path / "a.ply").read_bytes().partition(b"\nend_header\n")[0]
    assert (
        header.isascii() and b"comment prompt: paint end_header it gr\\xfcn" in header
    )
    assert load_ply(tmp_path / "a.ply").count == 50


def test_empty_scene_comes_back(tmp_path):
    save_ply(tmp_path / "a.ply", scene(0, degree=1))
    assert load_ply(tmp_path / "a.ply").count == 0


def test_a_batch_and_values_that_are_not_finite_are_not_saved(tmp_path):
    pair = scene(3)
    with pytest.raises(InputError, match="one scene"):
        save_ply(
            tmp_path / "a.ply",
            Gaussians(
                *(torch.cat([getattr(pair, n)] * 2) for n in list(vars(pair))[:5])
            ),
        )
    pair.means[0, 0, 0] = float("nan")
    with pytest.raises(InputError, match="not finite"):
        save_ply(tmp_path / "a.ply", pair)
    assert not list(tmp_path.iterdir())


def rewritten(path):
    """The PLY at `path` as big-endian doubles, by numpy alone; with an extra property, as other
    tools add them.
    """
    header, _, body = path.read_bytes().partition(b"end_header\n")
    names = [
        line.split()[2]
        for line in header.decode().splitlines()
        if line.startswith("property")
    ]
    table = np.frombuffer(body, "<f4").reshape(-1, len(names))
    lines = [
        "ply",
        "format binary_big_endian 1.0",
        "obj_info made elsewhere",
        f"element vertex {len(table)}",
    ]
    lines += [f"property double {name}" for name in names] + [
        "property uchar extra",
        "element face 0",
    ]
    lines += ["property list uchar int vertex_indices", "end_header", ""]
    rows = np.empty(len(table), [(name, ">f8") for name in names] + [("extra", "u1")])
    for column, name in enumerate(names):
        rows[name] = table[:, column]
    path.write_bytes("\n".join(lines).encode() + rows.tobytes())


def test_other_layouts_types_and_extra_properties_are_read(tmp_path):
    save_ply(tmp_path / "a.ply", scene(degree=2))
    rewritten(tmp_path / "a.ply")
    assert_same(load_ply(tmp_path / "a.ply"), scene(degree=2))


def test_gaussians_that_are_not_finite_are_left_out_with_a_warning(tmp_path):
    save_ply(tmp_path / "a.ply", scene(4, view_index=torch.tensor([0, 0, 1, 1])))
    content = bytearray((tmp_path / "a.ply").read_bytes())
    start = content.index(b"end_header\n") + len(b"end_header\n")
    content[start : start + 4] = np.float32("nan").tobytes()
    (tmp_path / "a.ply").write_bytes(content)
    with collecting(Report()) as report:
        loaded = load_ply(tmp_path / "a.ply")
    assert loaded.view_index.tolist() == [0, 1, 1]
    assert "1 of 4 Gaussians are not finite" in report.warnings[0]


def complain(path):
    with pytest.raises(InputError) as caught:
        load_ply(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_what_is_no_ply_is_one_sentence(tmp_path):
    assert "no such file" in complain(tmp_path / "none.ply")
    (tmp_path / "a.ply").write_bytes(b"\x89PNG" * 10)
    assert "not a PLY" in complain(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(b"")
    assert "not a PLY" in complain(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(
        b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    )
    assert "end of its header" in complain(tmp_path / "a.ply")


def test_truncated_ply_says_how_much_is_there(tmp_path):
    save_ply(tmp_path / "a.ply", scene(50))
    content = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(content[:-100])
    assert "promises 50 Gaussians, 48 are there" in complain(tmp_path / "a.ply")


def test_absurd_count_is_refused_without_reserving_memory(tmp_path):
    save_ply(tmp_path / "a.ply", scene(5))
    content = (
        (tmp_path / "a.ply")
        .read_bytes()
        .replace(b"element vertex 5\n", b"element vertex 99999999999999\n")
    )
    (tmp_path / "a.ply").write_bytes(content)
    assert "5 are there" in complain(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (b"property float opacity\n", b"property float other\n", "lacks opacity"),
        (
            b"property float f_rest_0\n",
            b"property float f_more_0\n",
            "8 f_rest properties",
        ),
        (b"property float opacity\n", b"property quad opacity\n", "unknown type"),
        (
            b"element vertex 5\n",
            b"element vertex five\n",
            "expected a number of vertices",
        ),
        (b"property float scale_1\n", b"property float scale_0\n", "same name"),
        (b"format binary_little_endian", b"format morse", "known format"),
        (b"element vertex", b"element face 0\nelement vertex", "first element"),
    ],
)
def test_header_faults_are_named(tmp_path, old, new, expected):
    save_ply(tmp_path / "a.ply", scene(5, degree=1))
    (tmp_path / "a.ply").write_bytes(
        (tmp_path / "a.ply").read_bytes().replace(old, new, 1)
    )
    assert expected in complain(tmp_path / "a.ply")


def test_plain_point_cloud_is_told_apart(tmp_path):
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 1"]
    lines += [*(f"property float {n}" for n in "xyz"), "end_header", ""]
    (tmp_path / "a.ply").write_bytes("\n".join(lines).encode() + bytes(12))
    assert "does not hold 3D Gaussians, it lacks opacity" in complain(
        tmp_path / "a.ply"
    )


def as_text(path, more=""):
    """A saved scene's file as text, with `more` elements behind its vertices."""
    header = read_header(path)
    table = header.read_vertices()
    lines = ["ply", "format ascii 1.0", f"element vertex {header.count}"]
    lines += [f"property float {name}" for name in header.names]
    lines += [*(more and ["element face 1", more]), "end_header"]
    rows = [" ".join(f"{value:.9g}" for value in row) for row in table.tolist()]
    path.write_text("\n".join([*lines, *rows, *(more and ["3 0 1 2"])]) + "\n")


@pytest.mark.parametrize("more", ["", "property list uchar int vertex_indices"])
def test_text_holds_the_same_scene(tmp_path, more):
    save_ply(tmp_path / "a.ply", scene(degree=2))
    binary = load_ply(tmp_path / "a.ply")
    as_text(tmp_path / "a.ply", more)
    text = load_ply(tmp_path / "a.ply")
    torch.testing.assert_close(text.means, binary.means)
    torch.testing.assert_close(text.harmonics, binary.harmonics)
    torch.testing.assert_close(text.scales, binary.scales)


@pytest.mark.parametrize(("end", "told"), [("0 1", "cannot be read"), ("", "promises")])
def test_text_that_is_cut_off_or_no_number_is_one_sentence(tmp_path, end, told):
    save_ply(tmp_path / "a.ply", scene(degree=0))
    as_text(tmp_path / "a.ply")
    lines = (tmp_path / "a.ply").read_text().splitlines()[:-1]
    (tmp_path / "a.ply").write_text("\n".join([*lines, end]))
    assert told in complain(tmp_path / "a.ply")


def without(path, *names, colours=(), kind="u1"):
    """The scene's file without some properties, and with others: as bytes 100, 150, 200."""
    header = read_header(path)
    table = header.read_vertices()
    kept = [name for name in header.names if name not in names]
    kinds = [(name, "<f4") for name in kept] + [(name, kind) for name in colours]
    new = np.zeros(len(table), kinds)
    for name in kept:
        new[name] = table[name]
    for level, name in enumerate(colours):
        new[name] = (100 + 50 * level) / (1 if kind == "u1" else 255)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(new)}"]
    lines += [f"property {'float' if k == '<f4' else 'uchar'} {n}" for n, k in kinds]
    head = "\n".join([*lines, "end_header", ""]).encode()
    path.write_bytes(head + new.tobytes())


def test_two_scales_are_those_of_flat_discs_and_one_that_of_a_ball(tmp_path):
    made = scene(degree=0)
    save_ply(tmp_path / "a.ply", made)
    without(tmp_path / "a.ply", "scale_2")
    flat = load_ply(tmp_path / "a.ply", visible=True).scales
    torch.testing.assert_close(flat[..., :2], made.scales[..., :2])
    torch.testing.assert_close(flat[..., 2], flat[..., :2].amin(-1) * 1e-3)
    without(tmp_path / "a.ply", "scale_1")
    ball = load_ply(tmp_path / "a.ply").scales
    torch.testing.assert_close(ball, made.scales[..., :1].expand_as(ball))


def with_column(path, name, values, replaced=False):
    """Give the Gaussians of a PLY one more property, or another value of one."""
    content = path.read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n")
    header = read_header(path)
    kinds = [(known, f"<{kind}") for known, kind in header.columns]
    table = np.frombuffer(content[start:], kinds)
    new = np.zeros(len(table), [*kinds, *[(name, "<f4")] * (not replaced)])
    for known, _ in kinds:
        new[known] = table[known]
    new[name] = values
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(new)}"]
    lines += [f"property float {known}" for known in new.dtype.names]
    head = "\n".join([*lines, "end_header", ""]).encode()
    path.write_bytes(head + new.tobytes())


def test_the_filter_of_mip_splatting_is_worked_in_and_said(tmp_path):
    made = scene(degree=0)
    save_ply(tmp_path / "a.ply", made)
    with_column(tmp_path / "a.ply", "filter_3D", 0.03)
    with collecting(Report()) as report:
        loaded = load_ply(tmp_path / "a.ply")
    wide = (made.scales**2 + 0.03**2).sqrt()
    # what each Gaussian holds in all, opacity times volume, stays
    held = made.opacities * made.scales.prod(-1)
    torch.testing.assert_close(loaded.scales, wide)
    torch.testing.assert_close(loaded.opacities * wide.prod(-1), held)
    assert "filter_3D" in report.notes["scene.filter"] and not report.warnings


def test_properties_that_are_not_known_are_named(tmp_path):
    save_ply(tmp_path / "a.ply", scene(degree=1))
    with_column(tmp_path / "a.ply", "time_scale", 1.0)
    with collecting(Report()) as report:
        load_ply(tmp_path / "a.ply")
    assert len(report.warnings) == 1 and "time_scale;" in report.warnings[0]


@pytest.mark.parametrize("unit", [1, 1000])
def test_sizes_that_cannot_be_logarithms_are_lengths(tmp_path, unit):
    made = scene(400, degree=0)
    made = replace(made, means=made.means * unit, scales=made.scales * unit)
    save_ply(tmp_path / "a.ply", made)
    with collecting(Report()) as report:
        torch.testing.assert_close(load_ply(tmp_path / "a.ply").scales, made.scales)
    assert not report.warnings
    for axis in range(3):
        lengths = made.scales[0, :, axis]
        with_column(tmp_path / "a.ply", f"scale_{axis}", lengths, replaced=True)
    with collecting(Report()) as report:
        torch.testing.assert_close(load_ply(tmp_path / "a.ply").scales, made.scales)
    assert "cannot be logarithms" in report.warnings[0]


@pytest.mark.parametrize("kind", ["u1", "<f4"])
def test_colours_stand_in_for_harmonics(tmp_path, kind):
    save_ply(tmp_path / "a.ply", scene(degree=0))
    plain = ("f_dc_0", "f_dc_1", "f_dc_2")
    without(tmp_path / "a.ply", *plain, colours=("red", "green", "blue"), kind=kind)
    colours = dc_to_colour(load_ply(tmp_path / "a.ply").harmonics[0, 0, 0])
    np.testing.assert_allclose(colours, np.array([100, 150, 200]) / 255, atol=1e-6)


def test_a_scene_that_was_saved_and_loaded_keeps_its_bytes_when_it_is_saved_again(
    tmp_path,
):
    """Editing again relies on it: what no edit touches goes from file to file."""
    generator = torch.Generator().manual_seed(0)
    count = 100_000
    scales = 10 ** (8 * torch.rand(1, count, 3, generator=generator) - 6)
    opacities = torch.rand(1, count, generator=generator) ** torch.randint(
        1, 20, (1, count), generator=generator
    )
    quats = torch.randn(1, count, 4, generator=generator)
    means, harmonics = (
        torch.randn(1, count, *shape, generator=generator) for shape in ((3,), (4, 3))
    )
    save_ply(tmp_path / "1.ply", Gaussians(means, scales, quats, opacities, harmonics))
    save_ply(tmp_path / "2.ply", load_ply(tmp_path / "1.ply"))
    save_ply(tmp_path / "3.ply", load_ply(tmp_path / "2.ply"))
    assert (tmp_path / "2.ply").read_bytes() == (tmp_path / "3.ply").read_bytes()


def test_a_long_comment_is_cut_so_that_the_file_stays_readable(tmp_path):
    save_ply(tmp_path / "a.ply", scene(), comment_lines=["prompt: " + "é" * 2_000_000])
    assert load_ply(tmp_path / "a.ply").count == 50
    assert (tmp_path / "a.ply").stat().st_size < 50_000


@pytest.mark.parametrize(
    "runs",
    [
        "0:49",
        "0:25 1:26",
        "0:1000000000000",
        "0:-3 0:53",
        "0:50 1:" + "9" * 5000,
        "9" * 5000 + ":50",
        "0 50",
        "a:b",
    ],
)
def test_runs_of_views_that_do_not_fit_are_left_out(tmp_path, runs):
    save_ply(tmp_path / "a.ply", scene(view_index=torch.zeros(50, dtype=torch.int64)))
    content = (tmp_path / "a.ply").read_bytes()
    assert b"(view:count) 0:50\n" in content
    (tmp_path / "a.ply").write_bytes(
        content.replace(b"(view:count) 0:50", b"(view:count) " + runs.encode())
    )
    assert (load_ply(tmp_path / "a.ply").view_index == -1).all()


def test_a_count_of_thousands_of_digits_is_one_sentence(tmp_path):
    save_ply(tmp_path / "a.ply", scene())
    content = (
        (tmp_path / "a.ply")
        .read_bytes()
        .replace(b"vertex 50", b"vertex " + b"9" * 5000)
    )
    (tmp_path / "a.ply").write_bytes(content)
    assert "expected a number of vertices" in complain(tmp_path / "a.ply")


def test_a_scene_that_shows_nothing_is_refused_where_it_is_to_be_seen(tmp_path):
    hidden = replace(scene(), opacities=torch.full((1, 50), 1e-4))
    save_ply(tmp_path / "a.ply", hidden)
    assert load_ply(tmp_path / "a.ply").count == 50
    with pytest.raises(InputError, match=r"a\.ply: shows nothing"):
        load_ply(tmp_path / "a.ply", visible=True)


@pytest.mark.parametrize("away, told", [(0, False), (1e4, False), (4e6, True)])
def test_a_scene_where_numbers_are_too_coarse_for_it_is_told(tmp_path, away, told):
    gaussians = scene()
    save_ply(tmp_path / "a.ply", replace(gaussians, means=gaussians.means + away))
    with collecting(Report()) as report:
        load_ply(tmp_path / "a.ply")
    assert ["from the origin" in text for text in report.warnings] == [True] * told
