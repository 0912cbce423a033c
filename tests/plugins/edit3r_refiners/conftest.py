import pytest

import edit3r


@pytest.fixture(scope="package")
def rasterizer():
    return edit3r.build("rasterizer", "numba", threads=1)
