"""What every contract says before it can ask anything of a component."""

import pytest

from edit3r_testing import ContractViolation, EditorContract


def test_a_component_that_is_not_installed_is_said_in_one_line_with_what_to_do():
    class TestAway(EditorContract):
        component = "far-away"

    with pytest.raises(ContractViolation) as violation:
        TestAway().test_declaration_keeps_its_promises()
    text = str(violation.value)
    assert "no editor named 'far-away'" in text and "\n" not in text
    assert "pip install -e" in text and "plugin_files" in text
