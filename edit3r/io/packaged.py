"""Photos that need no download, to try things with."""

from pathlib import Path


def packaged_pair() -> tuple[list[str], Path]:
    """The real photo pair that scikit-image ships (Middlebury 2014, Motorcycle), and its published calibration."""
    import skimage

    folder = Path(skimage.__file__).parent / "data"
    photos = [str(folder / f"motorcycle_{side}.png") for side in ("left", "right")]
    return photos, Path(__file__).with_name("motorcycle_cameras.json")
