"""From folders of photos to a manifest: labels, proposals, a person's verdicts, masks."""

import base64
import io
import json
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest
import torch
import yaml
from edit3r_bench.manifest import load_item, read_bench_manifest
from edit3r_bench.photos import find_photo_folders
from edit3r_bench.proposals import (
    ProposedEdit,
    choose_edits,
    edits_from_templates,
    find_objects,
    read_vetting,
    without_near_duplicates,
    write_vetting,
)
from PIL import Image
from scipy.spatial.transform import Rotation

from edit3r.cli.main import main
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.interfaces import Detection
from edit3r.loading.registry import default_registry

DETECTOR = '''
"""Local plugin: finds a cup in the middle of every picture, and nothing else."""

from edit3r import Component, hookimpl
from edit3r.contract.interfaces import Detection, Detector

EDIT3R_API = 1


class Middle(Detector):
    def __init__(self, settings):
        pass

    def detect(self, image, text):
        height, width = image.shape[-2:]
        box = (0.25 * width, 0.25 * height, 0.5 * width, 0.5 * height)
        return (Detection("cup", 0.9, box),) if text == "cup" else ()


@hookimpl
def register_detectors():
    return [Component(name="middle", target=f"{__name__}:Middle", summary="a cup in the middle")]
'''


@pytest.fixture
def folder(tmp_path):
    """Two scenes of three photos, and a folder of something else."""
    rng = np.random.default_rng(0)
    for scene in ("kitchen", "garden"):
        (tmp_path / "scenes" / scene).mkdir(parents=True)
        for index in range(3):
            picture = Image.fromarray(rng.integers(0, 255, (48, 64, 3), np.uint8))
            picture.save(tmp_path / "scenes" / scene / f"{index}.png")
    (tmp_path / "scenes" / "notes").mkdir()
    (tmp_path / "scenes" / "notes" / "todo.txt").write_text("more photos")
    return tmp_path / "scenes"


@pytest.fixture(scope="module")
def detector(tmp_path_factory):
    path = tmp_path_factory.mktemp("plugin") / "middle.py"
    path.write_text(DETECTOR)
    return ["--detector", "middle", "--plugin", str(path)]


def build_of(folder, *more):
    """Run the command; its exit code."""
    out = str(folder.parent / "bench.json")
    command = ["bench", "build", str(folder), "--out", out, "--size", "64", "--quiet"]
    return main([*command, *more])


def build(folder, *more):
    """Run the command; the manifest's path."""
    assert build_of(folder, *more) == 0
    return folder.parent / "bench.json"


# ---- scenes ----


def test_scenes_are_folders_with_photos_and_without_poses_inputs_are_spread(folder):
    scenes = find_photo_folders(folder, views=2)
    assert [scene.id for scene in scenes] == ["garden", "kitchen"]
    first = scenes[0]
    assert (first.inputs, first.held_back, first.cameras) == ((0, 2), (), "")
    (alone,) = find_photo_folders(folder / "garden", views=3)
    assert alone.id == "garden"


@pytest.fixture
def posed(folder):
    """The folder with poses for one of its scenes."""
    poses = []
    for index, angle in enumerate((0, 6, 12)):
        turn = np.deg2rad(angle)
        c2w = np.eye(4)
        c2w[:3, :3] = Rotation.from_euler("y", turn).as_matrix()
        c2w[0, 3] = -np.sin(turn)
        about = {"file": f"{index}.png", "width": 64, "height": 48, "c2w": c2w.tolist()}
        poses.append({**about, "K": [[60, 0, 32], [0, 60, 24], [0, 0, 1]]})
    (folder / "garden" / "cameras.json").write_text(json.dumps(poses))
    return folder


def test_posed_photos_hold_one_back_between_the_inputs(posed):
    scene = find_photo_folders(posed, views=2)[0]
    assert (scene.inputs, scene.held_back) == ((0, 2), (1,))


def test_poses_are_known_for_measuring_and_apart_from_what_a_method_is_given(posed):
    out = build(posed, "--no-vetting")
    manifest = read_bench_manifest(out)
    item = load_item(manifest, manifest.items[0], out.parent, default_registry())
    assert item.photos.c2w is None and item.inputs == 2
    angles = item.cameras.c2w[0, :, 0, 2].arcsin().rad2deg()
    assert np.allclose(angles, [0, 12, 6], atol=0.01)


def test_a_folder_without_scenes_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="at least two photos"):
        find_photo_folders(tmp_path, views=2)


# ---- proposals ----


@pytest.mark.parametrize(("shown_by", "counts"), [(0, False), (1, False), (2, True)])
def test_an_object_counts_where_half_of_the_photos_show_it(shown_by, counts):
    photos = [torch.full((3, 8, 8), index / 4) for index in range(4)]

    class Shown:
        def detect(self, image, word):
            index = round(4 * float(image[0, 0, 0]))
            return (Detection(word, 0.9, (0, 0, 2, 2)),) * (index < shown_by)

    assert ("cup" in find_objects(photos, Shown(), ["cup"])) == counts


@pytest.mark.parametrize(
    ("first", "second", "alike"),
    [
        ("Paint the door red.", "paint doors red", True),
        ("Add a red hat to the statue", "add to the statue a red hat", True),
        ("paint the door red", "paint the wall red", False),
        ("remove the cup", "remove the bowl", False),
        ("make it snow", "turn it into a desert at night", False),
    ],
)
def test_near_duplicates_are_told_from_other_edits(first, second, alike):
    for prompts in ((first, second), (second, first)):
        edits = [ProposedEdit(type="Modify", prompt=prompt) for prompt in prompts]
        kept = [edit.prompt for edit in without_near_duplicates(edits)]
        assert kept == list(prompts[:1] if alike else prompts)


def test_templates_name_the_objects_and_cover_all_types():
    found = edits_from_templates(["cup", "bowl"], seed=0)
    assert {edit.type for edit in found} == {"Add", "Remove", "Modify", "Global"}
    assert all(edit.object in edit.prompt for edit in found)
    first, again, other = (edits_from_templates(["cup"], seed) for seed in (0, 0, 1))
    assert first == again != other


class FakeModel(BaseHTTPRequestHandler):
    """Answers every chat with the class's `answer`, as an OpenAI-compatible server does."""

    answer = ""
    requests: list = []  # noqa: RUF012

    def do_POST(self):
        asked = self.rfile.read(int(self.headers["Content-Length"]))
        self.requests.append((self.path, json.loads(asked)))
        message = {"role": "assistant", "content": self.answer}
        choice = {"index": 0, "finish_reason": "stop", "message": message}
        about = {"id": "1", "object": "chat.completion", "created": 0, "model": "m"}
        body = json.dumps({**about, "choices": [choice]})
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.end_headers()
        self.wfile.write(body.encode())

    def log_message(self, *arguments):
        pass


@pytest.fixture
def server(monkeypatch):
    pytest.importorskip("openai")
    for name in ("http_proxy", "https_proxy", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    served = HTTPServer(("127.0.0.1", 0), FakeModel)
    FakeModel.requests.clear()
    threading.Thread(target=served.serve_forever, daemon=True).start()
    yield ["--llm", f"http://127.0.0.1:{served.server_port}/v1", "--llm-model", "tiny"]
    served.shutdown()
    served.server_close()


def test_a_language_model_proposes_and_nonsense_is_left_out(folder, detector, server):
    gold = {"type": "modify", "prompt": "turn the  cup into gold", "object": "cup"}
    gold["description"] = "a golden cup"
    unseen = {"type": "Remove", "prompt": "remove the elephant", "object": "elephant"}
    unknown = {"type": "Rotate", "prompt": "rotate the cup", "object": "cup"}
    proposals = [gold, unseen, unknown, "paint it"]
    FakeModel.answer = f"Sure! ```json\n{json.dumps(proposals)}```"
    build(folder, *detector, *server)
    edits = read_vetting(folder.parent / "bench.vetting.yaml")["garden"]
    asked = [edit for edit in edits if edit.source == "tiny"]
    assert [(e.type, e.prompt, e.description) for e in asked] == [
        ("Modify", "turn the cup into gold", "a golden cup")
    ]
    path, request = FakeModel.requests[0]
    text, *pictures = request["messages"][1]["content"]
    assert path == "/v1/chat/completions" and "cup" in text["text"]
    codes = [p["image_url"]["url"].partition(",")[2] for p in pictures]
    shown = [Image.open(io.BytesIO(base64.b64decode(code))) for code in codes]
    files = [folder / "garden" / f"{index}.png" for index in range(3)]
    photos = [Image.open(file).convert("RGB") for file in files]
    assert [image.size for image in shown] == [photo.size for photo in photos]
    for mine, photo in zip(shown, photos):  # noise, of which JPEG keeps the coarse part
        coarse = [
            np.asarray(image.resize((8, 6), Image.Resampling.BOX), int)
            for image in (mine, photo)
        ]
        assert np.abs(coarse[0] - coarse[1]).max() < 12


def test_a_model_that_answers_nonsense_ends_in_one_sentence(folder, server, capsys):
    FakeModel.answer = "I would rather not."
    assert build_of(folder, *server) == 1
    assert "no usable edit in its answer" in capsys.readouterr().err


def test_objects_are_looked_for_in_all_photos_and_masks_made_of_the_inputs(
    folder, tmp_path
):
    seen = tmp_path / "seen.txt"
    plugin = tmp_path / "counting.py"
    look = f"        open({str(seen)!r}, 'a').write(f'{{text}} {{float(image.mean()):.7f}}\\n')\n"
    plugin.write_text(
        DETECTOR.replace("        height, width", look + "        height, width", 1)
    )
    options = f"--detector middle --plugin {plugin} --labels cup --no-vetting".split()
    manifest = read_bench_manifest(build(folder, *options))
    assert len(set(seen.read_text().split("\n"))) - 1 == 6  # three photos of two scenes
    local = next(item for item in manifest.items if item.type == "Modify")
    assert len(local.masks) == len(local.inputs) == 2


def test_as_many_scenes_are_drawn_as_are_asked_for(folder, capsys):
    drawn = build(folder, "--labels", "cup", "--no-vetting", "--scenes", "1")
    assert len(read_bench_manifest(drawn).scenes) == 1
    assert build_of(folder, "--scenes", "20") == 2
    assert "holds 2 scenes, --scenes asks for 20" in capsys.readouterr().err


# ---- vetting ----


def edits(*verdicts):
    kinds = ("Add", "Remove", "Modify", "Global")
    return [
        ProposedEdit(verdict=v, type=kinds[n % 4], prompt=f"edit {n}")
        for n, v in enumerate(verdicts)
    ]


def test_kept_edits_stay_and_undecided_ones_fill_up_to_five_type_by_type():
    chosen = choose_edits("s", edits("keep", "", "drop", "", "keep", "", "", ""))
    assert [edit.prompt for edit in chosen] == [f"edit {n}" for n in (0, 4, 1, 6, 3)]


@pytest.mark.parametrize(
    ("verdicts", "words"),
    [(["keep"] * 6, "6 edits are kept"), (["", "drop"] * 3, "only 3 edits")],
)
def test_other_than_five_is_refused(verdicts, words):
    with pytest.raises(InputError, match=words):
        choose_edits("s", edits(*verdicts))


def test_the_vetting_file_reads_back_and_names_what_is_wrong_in_it(tmp_path):
    path = tmp_path / "v.yaml"
    edit = ProposedEdit(
        type="Add", prompt="add a dog, “please”", object="dog", source="template"
    )
    write_vetting(path, {"s": [edit]})
    assert read_vetting(path)["s"] == [edit]
    path.write_text(path.read_text().replace("verdict: ''", "verdict: maybe"))
    with pytest.raises(SettingsError, match=r"scenes\.s\.0\.verdict.*maybe"):
        read_vetting(path)


# ---- the whole way ----


def test_a_persons_verdicts_and_words_reach_the_manifest(folder, detector):
    out = build(folder, *detector)
    vetting = folder.parent / "bench.vetting.yaml"
    assert not out.exists() and vetting.exists()
    content = yaml.safe_load(vetting.read_text())
    first, second = content["scenes"]["garden"][:2]
    first.update(verdict="drop")
    second.update(verdict="keep", prompt="put a crown on the cup")
    vetting.write_text(yaml.safe_dump(content))
    build(folder, *detector)
    manifest = read_bench_manifest(out)
    own = [item for item in manifest.items if item.scene == "garden"]
    assert len(manifest.items) == 10 and len(own) == 5
    prompts = [item.prompt for item in own]
    assert "put a crown on the cup" in prompts and first["prompt"] not in prompts


def test_local_edits_get_masks_where_the_detector_looked(folder, detector):
    out = build(folder, *detector, "--no-vetting")
    manifest = read_bench_manifest(out)
    removal = next(item for item in manifest.items if item.type == "Remove")
    item = load_item(manifest, removal, out.parent, default_registry())
    mask = item.masks[0]
    assert mask[24, 32] == 1 and mask[2, 2] == 0 and 0.2 < mask.mean() < 0.35
    assert not next(item for item in manifest.items if item.type == "Global").masks


def test_a_photo_that_changed_since_is_noticed(folder, detector):
    out = build(folder, *detector, "--no-vetting")
    manifest = read_bench_manifest(out)
    Image.new("RGB", (64, 48)).save(folder / "garden" / "0.png")
    with pytest.raises(
        InputError, match="not the image that the manifest was built with"
    ):
        load_item(manifest, manifest.items[0], out.parent, default_registry())


def vetted(folder):
    """Build with the truth of an editor, of five edits; the exit code."""
    local = ("make it black and white", "paint everything red", "paint everything blue")
    kinds = {"Modify": local, "Global": ("make it warmer", "make it darker")}
    edits = [
        {"verdict": "keep", "type": kind, "prompt": prompt}
        for kind, prompts in kinds.items()
        for prompt in prompts
    ]
    scenes = {scene: edits for scene in ("kitchen", "garden")}
    vetting = folder.parent / "bench.vetting.yaml"
    vetting.write_text(yaml.safe_dump({"scenes": scenes}))
    return build_of(folder, "--truth", "recolor")


@pytest.mark.slow
def test_what_an_editor_makes_of_all_photos_is_the_truth(folder):
    assert vetted(folder) == 0
    manifest = read_bench_manifest(folder.parent / "bench.json")
    grey, red, _, warm, _ = (
        load_item(manifest, item, folder.parent, default_registry())
        for item in manifest.items[:5]
    )
    assert grey.truth.shape == grey.photos.images[0].shape
    assert len(grey.record.truth) == 2
    assert (grey.truth[:, 0] - grey.truth[:, 2]).abs().max() < 2 / 255
    assert red.masks.mean() > 0.9 and warm.masks is None
    (folder.parent / red.record.truth[0].file).write_bytes(b"changed")
    with pytest.raises(InputError, match="not the image that the manifest was built"):
        load_item(manifest, red.record, folder.parent, default_registry())


def test_an_edit_that_leaves_a_photo_as_it_was_is_no_truth(folder, capsys):
    for scene in ("kitchen", "garden"):  # what is grey already does not become greyer
        grey = Image.open(folder / scene / "2.png").convert("L").convert("RGB")
        grey.save(folder / scene / "2.png")
    assert vetted(folder) == 2
    assert "left 2.png as it was; drop it" in capsys.readouterr().err
    assert not (folder.parent / "bench.json").exists()
