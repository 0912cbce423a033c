"""What a user writes: the public names with their types. Run by mypy only, never by Python."""

from pathlib import Path

import edit3r
from edit3r.contract.interfaces import SceneToWrite


def edit(folder: Path) -> str:
    bike = edit3r.Selection(positive=((0, 0.5, 0.4),), boxes={1: (0.1, 0.1, 0.5, 0.5)})
    views = edit3r.load_views([folder / "a.jpg", folder / "b.jpg"], size=512)
    result = edit3r.run(
        views,
        "paint the bike red",
        masks=bike,
        editor={"name": "recolor", "strength": 0.8},
        recon="edit3r",
        gaussians="auto",
        progress=True,
    )
    again = edit3r.run(prompt="make it night", earlier=result, seed=1)
    result.compare(again).save(folder / "both.png")
    written = SceneToWrite(again.gaussians, again.cameras)
    edit3r.build("writer", "spz").write(folder / "scene.spz", written)
    edit3r.save_ply(again.save(folder / "night") / "copy.ply", again.gaussians)
    first: edit3r.Cameras = again.cameras.select([0])
    shown = edit3r.build("rasterizer", "numba").render(again.gaussians, first)
    print(shown.images.shape, result.rendered.images.mean().item())
    if again.edit_verdict is not None:
        return again.edit_verdict.reason
    return again.verdict.label


def wrong(folder: Path) -> None:
    """Each line has one mistake, which mypy must find."""
    edit3r.run(folder / "a.jpg", prompt=3)  # type: ignore[arg-type]
    edit3r.run(folder / "a.jpg", promt="x")  # type: ignore[call-arg]
    edit3r.run(folder / "a.jpg", quality="good")  # type: ignore[arg-type]
    edit3r.Selection(words=1)  # type: ignore[arg-type]
    edit3r.run(folder).verdict.lable  # type: ignore[attr-defined]  # noqa: B018
