"""The modules of the pages find each other as they lie there: nothing builds them."""

import re

import pytest
from edit3r_app.server import STATIC

MODULES = sorted(STATIC.rglob("*.js"))
IMPORT = re.compile(r'^import \{([^}]*)\} from "([^"]+)";', re.MULTILINE)
EXPORT = re.compile(r"^export (?:async )?(?:function|const) (\w+)", re.MULTILINE)
SITTING = 350  # lines that one reads at once


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.stem)
def test_a_module_imports_what_another_exports(module):
    text = module.read_text(encoding="utf-8")
    assert text.count("\n") <= SITTING
    assert len(IMPORT.findall(text)) == len(re.findall(r"^import ", text, re.MULTILINE))
    for names, address in IMPORT.findall(text):
        there = (module.parent / address).read_text(encoding="utf-8")
        wanted = {name.strip() for name in names.split(",")} - {""}
        assert wanted <= set(EXPORT.findall(there)), address
