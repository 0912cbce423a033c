"""What the 3D losses hold the edited Gaussians to (section 3.3): G_ref, the geometry of the unedited photos."""

import copy
from dataclasses import replace

import torch

from edit3r.interfaces import Reconstructor, TrainingJob
from edit3r.types import Gaussians
from edit3r_training.batches import TrainingBatch


class GeometricReference:
    """The true surface where the data has depths, else what the frozen first-stage model makes of the photos."""

    def __init__(self, frozen: Reconstructor | None = None) -> None:
        self.frozen = frozen

    @staticmethod
    def of_start(job: TrainingJob) -> "GeometricReference":
        """Freeze a copy of the job's network as it is now, if its data has no depths and a loss may ask for it."""
        if not job.losses or job.train_data[0].context_depths is not None:
            return GeometricReference()
        frozen = copy.deepcopy(job.reconstructor)
        frozen.network.eval().requires_grad_(False)
        return GeometricReference(frozen)

    @torch.no_grad()
    def __call__(self, batch: TrainingBatch, gaussians: Gaussians) -> Gaussians | None:
        """Reference Gaussians, one for each predicted; None when there are none."""
        centres = batch.true_centres()
        if centres is None and self.frozen is not None:
            centres = self.frozen(batch.source, batch.source).gaussians.means
        if centres is None or centres.shape != gaussians.means.shape:
            return None
        return replace(gaussians, means=centres)
