"""How alike an image is to the one it should be: PSNR and SSIM.

Images are NumPy arrays `[height, width, 3]`, sRGB in [0, 1].
"""

import numpy as np
from jaxtyping import Bool, Float
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

Image = Float[np.ndarray, "height width 3"]
Region = Bool[np.ndarray, "height width"]


def psnr(image: np.ndarray, target: np.ndarray, covered: Region | None = None) -> float:
    """Return the PSNR [dB] of `image` clipped to [0, 1], over the `covered` pixels if given.

    Any equal shapes; infinite if they are equal, NaN when nothing is covered.
    """
    if covered is not None:
        if not covered.any():
            return float("nan")
        image = image[covered]
        target = target[covered]
    clipped = np.clip(image, 0, 1)
    with np.errstate(divide="ignore"):
        return float(peak_signal_noise_ratio(target, clipped, data_range=1.0))


def ssim(
    image: Image, target: Image, covered: Region | None = None, gaussian: bool = False
) -> float:
    """Return the mean structural similarity in [-1, 1] (Wang et al. 2004, mean over channels).

    In windows of 7x7 pixels, or as much as fits, or weighted by a Gaussian of 1.5 pixels in 11x11.
    Over the windows whose middle is a `covered` pixel if given, NaN when none is. Raises ValueError
    where no window fits.
    """
    smallest = min(target.shape[:2])
    window = 11 if gaussian else min(7, smallest - 1 + smallest % 2)
    if not 3 <= window <= smallest:
        raise ValueError(
            f"ssim: expected images of at least {max(3, window)} pixels a side, got "
            f"{target.shape[:2]}"
        )
    mean, values = structural_similarity(
        np.clip(image, 0, 1).astype(target.dtype),
        target,
        win_size=window,
        gaussian_weights=gaussian,
        channel_axis=-1,
        data_range=1.0,
        full=True,
    )
    if covered is None:
        return float(mean)
    return float(values[covered].mean()) if covered.any() else float("nan")
