"""Scenes are written again with an edit in them, and every other value has the bits it had."""

import gzip
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.interfaces import SceneToWrite
from edit3r.kit.geometry.harmonics import DC
from edit3r.kit.scenes.ply import read_header, save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.kit.scenes.rewriting import SceneChange, rewritten
from tests.plugins.scan import of_ball, scan

BLUE = (np.array([0.1, 0.2, 0.9]) - 0.5) / DC


def painted(count, changed, shine=None):
    """The chosen in blue, all kept."""
    return SceneChange(
        kept=np.ones(count, bool),
        changed=np.asarray(changed),
        plain=np.tile(BLUE, (int(changed.sum()), 1)),
        shine=np.eye(3) if shine is None else shine,
    )


def test_a_ply_keeps_its_header_its_other_columns_and_all_rows_but_the_painted(
    tmp_path,
):
    made = scan(degree=1)
    save_ply(tmp_path / "plain.ply", made, comment_lines=["by another program"])
    header = read_header(tmp_path / "plain.ply")
    table = header.read_vertices()
    # A column of another program, and an element after the vertices.
    wide = np.zeros(len(table), [*table.dtype.descr, ("filter_3D", "<f4")])
    for name in table.dtype.names:
        wide[name] = table[name]
    wide["filter_3D"] = np.arange(len(table))
    start = (tmp_path / "plain.ply").read_bytes()[: header.offset]
    more = b"property float filter_3D\nelement face 1\nproperty uchar a\nend_header\n"
    source = tmp_path / "scene.ply"
    source.write_bytes(start.replace(b"end_header\n", more) + wide.tobytes() + b"!")
    chosen = of_ball(made, 0)
    new = rewritten(source, painted(made.count, chosen))
    (tmp_path / "new.ply").write_bytes(new)
    before, after = read_header(source), read_header(tmp_path / "new.ply")
    assert new[: after.offset] == source.read_bytes()[: before.offset]
    assert new.endswith(b"!")
    old_rows, new_rows = before.read_vertices(), after.read_vertices()
    assert new_rows[~chosen.numpy()].tobytes() == old_rows[~chosen.numpy()].tobytes()
    changed = [n for n in old_rows.dtype.names if (old_rows[n] != new_rows[n]).any()]
    assert changed == ["f_dc_0", "f_dc_1", "f_dc_2"]
    found = load_scene(tmp_path / "new.ply").harmonics[0, chosen, 0]
    assert torch.allclose(found, torch.tensor(BLUE).float().expand_as(found))


def test_further_harmonics_of_a_ply_take_the_colours_of_the_shine(tmp_path):
    made = scan(degree=2)
    save_ply(tmp_path / "s.ply", made)
    shine = np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, 0.5]])
    chosen = of_ball(made, 1)
    content = rewritten(tmp_path / "s.ply", painted(made.count, chosen, shine))
    (tmp_path / "n.ply").write_bytes(content)
    found = load_scene(tmp_path / "n.ply").harmonics[0]
    expected = made.harmonics[0, chosen, 1:] @ torch.tensor(shine).float().T
    assert torch.allclose(found[chosen, 1:], expected, atol=1e-6)
    assert torch.equal(found[~chosen], made.harmonics[0, ~chosen])


def test_rows_that_no_scene_can_hold_stay_where_they_are(tmp_path):
    made = scan()
    broken = replace(made, means=made.means.clone())
    save_ply(tmp_path / "s.ply", broken)
    content = bytearray((tmp_path / "s.ply").read_bytes())
    header = read_header(tmp_path / "s.ply")
    size = header.read_vertices().dtype.itemsize
    struct.pack_into("<f", content, header.offset + 2 * size, float("nan"))
    (tmp_path / "s.ply").write_bytes(content)
    with pytest.warns(UserWarning, match="not finite"):
        count = load_scene(tmp_path / "s.ply").count
    changed = torch.zeros(count, dtype=torch.bool)
    changed[5] = True  # the row 6 of the file
    new = rewritten(tmp_path / "s.ply", painted(count, changed))
    differs = [
        row
        for row in range(made.count)
        if new[header.offset + row * size :][:size]
        != bytes(content[header.offset + row * size :][:size])
    ]
    assert differs == [6]


def test_a_text_ply_keeps_the_lines_of_all_others(tmp_path):
    made = scan().select(torch.arange(20))
    save_ply(tmp_path / "b.ply", made)
    header = read_header(tmp_path / "b.ply")
    rows = header.read_vertices()
    lines = [" ".join(f"{value:.7g}" for value in row) for row in rows.tolist()]
    start = (tmp_path / "b.ply").read_bytes()[: header.offset]
    start = start.replace(b"binary_little_endian", b"ascii")
    source = tmp_path / "s.ply"
    source.write_bytes(start + "\n".join(lines).encode() + b"\n")
    changed = torch.arange(20) == 3
    new = rewritten(source, painted(20, changed)).splitlines()
    old = source.read_bytes().splitlines()
    assert [i for i, pair in enumerate(zip(old, new)) if pair[0] != pair[1]] == [
        len(old) - 20 + 3
    ]
    kept = np.arange(20) != 4
    change = replace(painted(20, changed), kept=kept)
    (tmp_path / "n.ply").write_bytes(rewritten(source, change))
    assert load_scene(tmp_path / "n.ply").count == 19


def test_what_is_removed_from_a_ply_is_gone_and_guesses_come_last(tmp_path):
    made = scan()
    save_ply(tmp_path / "s.ply", made)
    kept = ~of_ball(made, 0)
    added = made.select(torch.arange(3))
    change = SceneChange(
        kept.numpy(), np.zeros(made.count, bool), np.zeros((0, 3)), np.eye(3), added
    )
    (tmp_path / "n.ply").write_bytes(rewritten(tmp_path / "s.ply", change))
    found = load_scene(tmp_path / "n.ply")
    assert torch.equal(found.means[0, :-3], made.means[0, kept])
    assert torch.equal(found.means[0, -3:], made.means[0, :3])


def written(tmp_path, name, gaussians):
    writer = edit3r.build("writer", name)
    path = tmp_path / f"s{writer.offer.component.suffix}"
    writer.write(path, SceneToWrite(gaussians))
    return path


@pytest.mark.slow
def test_an_spz_differs_in_the_colours_of_the_painted_alone(tmp_path):
    made = scan(degree=1)
    source = written(tmp_path, "spz", made)
    read = load_scene(source)
    chosen = of_ball(made, 0)
    content = rewritten(source, painted(made.count, chosen))
    old, new = (
        np.frombuffer(gzip.decompress(one), np.uint8)
        for one in (source.read_bytes(), content)
    )
    place = np.flatnonzero(old != new)
    assert len(old) == len(new)
    first = 16 + 10 * made.count
    assert ((place >= first) & (place < first + 3 * made.count)).all()
    (tmp_path / "n.spz").write_bytes(content)
    found = load_scene(tmp_path / "n.spz")
    for name in ("means", "scales", "quats", "opacities"):
        assert torch.equal(getattr(found, name), getattr(read, name))
    assert torch.equal(found.harmonics[0, ~chosen], read.harmonics[0, ~chosen])
    target = torch.tensor(BLUE).float()
    assert (found.harmonics[0, chosen, 0] - target).abs().max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spz", "compressed-ply"])
def test_the_shine_of_the_painted_is_changed_in_its_bytes_and_no_other(tmp_path, name):
    made = scan(degree=1)
    source = written(tmp_path, name, made)
    read = load_scene(source)
    nearest = torch.cdist(read.means[0], made.means[0]).argmin(1)
    chosen = of_ball(made, 0)[nearest]
    shine = np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, 0.5]])
    changed = source.with_name(f"new{source.name}")
    changed.write_bytes(rewritten(source, painted(made.count, chosen, shine)))
    found = load_scene(changed)
    assert torch.equal(found.quats, read.quats)
    old, new = read.harmonics[0, :, 1:], found.harmonics[0, :, 1:]
    assert torch.equal(new[~chosen], old[~chosen])
    expected = old[chosen] @ torch.tensor(shine).float().T
    assert (new[chosen] - expected).abs().max() <= 8 / 255  # a step of a byte
    assert expected.abs().max() > 0.1


@pytest.mark.slow
def test_a_splat_differs_in_the_colours_of_the_painted_alone(tmp_path):
    made = scan()
    source = written(tmp_path, "splat", made)
    read = load_scene(source)
    nearest = torch.cdist(read.means[0], made.means[0]).argmin(1)
    chosen = of_ball(made, 0)[nearest]  # it is sorted by size
    content = rewritten(source, painted(made.count, chosen))
    old, new = (
        np.frombuffer(one, np.uint8).reshape(-1, 32)
        for one in (source.read_bytes(), content)
    )
    assert set(np.flatnonzero((old != new).any(1))) <= set(
        chosen.nonzero()[:, 0].tolist()
    )
    assert not (old != new)[:, [*range(24), *range(27, 32)]].any()
    (tmp_path / "n.splat").write_bytes(content)
    target = torch.tensor(BLUE).float()
    assert (
        load_scene(tmp_path / "n.splat").harmonics[0, chosen, 0] - target
    ).abs().max() < 0.02


@pytest.mark.slow
def test_a_compressed_ply_keeps_all_but_colours_of_the_painted_and_their_chunks(
    tmp_path,
):
    made = scan(degree=1)
    source = written(tmp_path, "compressed-ply", made)
    read = load_scene(source)
    nearest = torch.cdist(read.means[0], made.means[0]).argmin(1)
    chosen = of_ball(made, 0)[nearest]
    (tmp_path / "n.compressed.ply").write_bytes(
        rewritten(source, painted(made.count, chosen))
    )
    found = load_scene(tmp_path / "n.compressed.ply")
    for name in ("means", "scales", "quats", "opacities"):
        assert torch.equal(getattr(found, name), getattr(read, name))
    target = torch.tensor(BLUE).float()
    assert (found.harmonics[0, chosen, 0] - target).abs().max() < 0.03
    off = (found.harmonics[0, ~chosen] - read.harmonics[0, ~chosen]).abs().max()
    assert off < 0.03  # one step of 255 within the wider bounds of a chunk


@pytest.mark.slow
def test_a_compressed_ply_keeps_every_bit_outside_the_groups_of_the_painted(tmp_path):
    made = scan(degree=1)
    source = written(tmp_path, "compressed-ply", made)
    read, chosen = load_scene(source), torch.arange(made.count) == 300
    (tmp_path / "n.compressed.ply").write_bytes(
        rewritten(source, painted(made.count, chosen))
    )
    found = load_scene(tmp_path / "n.compressed.ply")
    same = (found.harmonics == read.harmonics).flatten(2).all(2)[0]
    assert not same[300]
    assert same[:256].all() and same[512:].all()


@pytest.mark.slow
def test_what_hangs_together_is_left_to_a_writer(tmp_path):
    made = scan()
    source = written(tmp_path, "spz4", made)
    assert rewritten(source, painted(made.count, of_ball(made, 0))) is None
