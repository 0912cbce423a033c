"""Follow objects through views with SAM2's video predictor."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import Tracks
from edit3r.reporting import progress
from edit3r_segmenters.preprocess import binary_masks, enlarge, pixel_values


def follow(
    model: Any, images: Float[Tensor, "view 3 height width"], masks: Float[Tensor, "object height width"]
) -> Tracks:
    """Tracks of objects given on view 0, the views taken as the frames of a video."""
    from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

    views, size = len(images), tuple(images.shape[-2:])
    side = model.config.image_size
    session = Sam2VideoInferenceSession(
        video=pixel_values(images, side),
        video_height=size[0],
        video_width=size[1],
        inference_device=images.device,
        inference_state_device=images.device,
        video_storage_device=images.device,
        dtype=model.dtype,
    )
    for number, mask in enumerate(binary_masks(masks, side)):
        session.add_mask_inputs(session.obj_id_to_idx(number), 0, mask[None, None])
    session.obj_with_new_inputs = list(range(len(masks)))
    model(session, frame_idx=0)  # turns the masks into memories; propagation alone refuses to start
    logits, present = [], []
    for output in model.propagate_in_video_iterator(session):
        small = output.pred_masks[:, 0]
        frame = enlarge(small, size)
        logits.append(frame)
        present.append(is_present(frame, output.object_score_logits))
        progress("tracking objects", len(logits), views)
    return Tracks(torch.stack(logits), torch.stack(present))


def is_present(logits: Float[Tensor, "object height width"], scores: Float[Tensor, "object *_"]) -> Tensor:
    """Which objects are in a frame: those with a positive score or a mask that is not empty.

    The predictor's `object_ids` always lists every object, lost or not, so it cannot serve as the paper's O_v.
    """
    return (scores.flatten() > 0) | (logits > 0).flatten(1).any(1)
