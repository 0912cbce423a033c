"""The contracts of segmenters and detectors, kept on tiny random models."""

import pytest

from edit3r_testing import CONTRACTS, Contract, claims, contract_for

# Whether a black picture shows the object is knowledge, which random weights do not have; that a
# lost object's logits are not positive is tested in test_sam2.py.
LEARNED = "test_lost_objects_are_reported"


@pytest.fixture(scope="module")
def segmenter(sam2_folder, dino_folder):
    return contract_for(
        "segmenter",
        "sam2",
        model=str(sam2_folder),
        local_files_only=True,
        detector={"name": "grounding-dino", "model": str(dino_folder)},
    )


@pytest.fixture(scope="module")
def sam3(sam3_folder):
    bounds = {"min_score": 0.0}
    return contract_for(
        "segmenter", "sam3", model=str(sam3_folder), local_files_only=True, **bounds
    )


@pytest.fixture
def sam_onnx(sam_onnx_files):
    return contract_for("segmenter", "sam-onnx", **sam_onnx_files)


@pytest.fixture(scope="module")
def detector(dino_folder):
    return contract_for(
        "detector",
        "grounding-dino",
        model=str(dino_folder),
        local_files_only=True,
        box_threshold=0.0,
    )


def own_claims(kind: str) -> list[str]:
    """The claims of a kind but those about the declaration, which `tests/test_contracts.py`
    tries.
    """
    return sorted({*claims(CONTRACTS[kind])} - {*claims(Contract), LEARNED})


@pytest.mark.slow
@pytest.mark.parametrize("claim", own_claims("segmenter"))
@pytest.mark.parametrize("name", ["segmenter", "sam3", "sam_onnx"])
def test_segmenter_contract(request, name, claim):
    getattr(request.getfixturevalue(name)(), claim)()


@pytest.mark.parametrize("claim", own_claims("detector"))
def test_detector_contract(detector, claim):
    getattr(detector(), claim)()
