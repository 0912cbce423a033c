import pytest


@pytest.fixture
def measurement():
    """Makes one line of a sweep; times are of the runs that count, after a slow first one."""

    def make(label="base", scene="s0", kind="photos", seconds=(1.0, 2.0, 4.0), psnr=20.0, **others):
        warm_up = {"warm_up": True, "cpu": {"render": 99.0}, "wall": {"render": 99.0}, "load": 1.0}
        runs = [
            {
                "warm_up": False,
                "cpu": {"edit (x)": 0.25 * s, "render": 0.75 * s},
                "wall": {"render": 2 * s},
                "load": 1.0,
            }
            for s in seconds
        ]
        return {
            "key": f"{label}-{scene}",
            "label": label,
            "settings": {"size": 8},
            "scene": scene,
            "kind": kind,
            "threads": 1,
            "measured_at": "2020-01-02T03:04:05Z",
            "runs": [warm_up, *runs],
            "memory_mb": 500.0,
            "start_memory_mb": 300.0,
            "gaussians": 100,
            "ply_bytes": 2_000_000,
            "repeatable": True,
            "psnr": psnr,
            "ssim": 0.5,
            "perceptual": None,
            "perceptual_by": None,
            "perceptual_missing": {"lpips": "install it"},
            **others,
        }

    return make
