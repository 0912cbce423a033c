"""A stranger's loss of two renders: what changes from view to view, and how deep it lies."""

from edit3r import Component, hookimpl
from edit3r.contract.interfaces import Loss

EDIT3R_API = 1


class TwoRendersLoss(Loss):
    def __call__(self, inputs):
        first, last = (
            inputs.render(inputs.cameras.select([view])).images for view in (0, -1)
        )
        wished = inputs.target[:, :1] - inputs.target[:, -1:]
        shown = inputs.render(inputs.cameras)  # drawn already
        known = inputs.depths > 0
        unit = inputs.geometry.depths.median()
        deep = (shown.depths[:, :, 0] - inputs.depths) * known / unit
        return (first - last - wished).square().mean() + deep.square().mean()


@hookimpl
def register_losses():
    return Component("two-renders", "two_renders:TwoRendersLoss", "a stranger")
