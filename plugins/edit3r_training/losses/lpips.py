"""LPIPS (Zhang et al. 2018) with VGG features, as the paper uses; its backbone is downloaded at first use."""

from jaxtyping import Float
from torch import Tensor

from edit3r import config
from edit3r.errors import MissingDependencyError
from edit3r.interfaces import Loss, LossInputs
from edit3r_training.losses.needs import require


class LpipsLoss(Loss):
    """Mean LPIPS-VGG distance."""

    class Settings(config.Settings):
        pass

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._metric = _vgg_metric()

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        require(inputs, "lpips", "rendered", "target")
        metric = self._metric.to(inputs.rendered.device)
        return metric(inputs.rendered.flatten(0, 1), inputs.target.flatten(0, 1), normalize=True).mean()


def _vgg_metric():
    import lpips

    try:
        return lpips.LPIPS(net="vgg", verbose=False).eval().requires_grad_(False)
    except (OSError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise MissingDependencyError(
            f"loss 'lpips' could not get its VGG weights ({reason}); connect to the network once, or use the loss "
            "'perceptual', which works offline."
        ) from error
