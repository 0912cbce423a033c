"""The documentation says all there is, and what it shows is true: examples run, generated parts are
current.
"""

import ast
import importlib.util
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import yaml
from markdown.extensions.toc import slugify

import edit3r
from edit3r.contract import hookspecs
from edit3r.contract.component import KINDS, hook_name
from edit3r.loading.describe import settings_lines
from edit3r.loading.registry import default_registry
from edit3r.running.config import RunConfig
from edit3r_testing import CONTRACTS, Contract, claims, contract_for

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = {
    path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8")
    for path in sorted(DOCS.rglob("*.md"))
}
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)]*))?\)")  # target, anchor
BLOCK = re.compile(r'```python title="([^"]+)"\n(.*?)```', re.DOTALL)


def load_generator():
    spec = importlib.util.spec_from_file_location("docs_generate", DOCS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generate = load_generator()
PAGES = {name: generate.completed(text) for name, text in PAGES.items()}
REFERENCE = generate.reference_pages(default_registry())


# ---- nothing is left out ----


def test_every_hook_is_documented():
    for kind in KINDS:
        hook = hook_name(kind)
        assert getattr(hookspecs, hook).__doc__, hook
        assert f"`{hook}`" in PAGES[f"plugins/{kind}.md"], hook
        assert f"`{hook}`" in REFERENCE["reference/hooks.md"], hook


@pytest.mark.parametrize("kind", KINDS)
def test_every_component_and_setting_of_a_kind_is_documented(kind):
    texts = [*PAGES.values(), (ROOT / "README.md").read_text(encoding="utf-8")]
    page = REFERENCE[f"reference/components/{kind}.md"]
    for offer in default_registry().offers(kind):
        name = f"`{offer.component.name}`"
        assert f"## {name}" in page, name
        assert any(name in text for text in texts), f"{kind} {name} is on no page"
        assert offer.component.summary.strip() and offer.component.licence.strip(), name
        if default_registry().missing(offer):
            continue
        for line in settings_lines(default_registry().settings_class(offer)):
            assert len(line.sentence) > 2, f"{kind} {name}.{line.name}: no description"
            assert f"| `{line.name}` |" in page, f"{kind} {name}.{line.name}"


def test_every_setting_of_a_run_is_documented():
    for line in settings_lines(RunConfig):
        assert line.sentence and f"`{line.name}`" in REFERENCE["reference/run.md"]


def test_every_command_is_documented():
    texts = [*PAGES.values(), (ROOT / "README.md").read_text(encoding="utf-8")]
    for command in generate.commands():
        assert f"## `edit3r {command}`" in REFERENCE["reference/commands.md"], command
        assert any(f"edit3r {command}" in text for text in texts), (
            f"no page of docs/ shows `edit3r {command}`"
        )


def test_every_public_name_has_a_docstring():
    for name in edit3r.__all__:
        value = getattr(edit3r, name)
        assert name == "__version__" or value.__doc__, f"edit3r.{name} has no docstring"


def test_every_contract_is_told_on_the_page_of_its_kind():
    for kind, contract in CONTRACTS.items():
        for claim in claims(contract):
            page = "testing" if claim in claims(Contract) else kind
            told = claim.removeprefix("test_").replace("_", " ")
            assert told in PAGES[f"plugins/{page}.md"]


def test_every_page_is_in_the_navigation_and_every_entry_exists():
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    assert {*_leaves(nav)} == {*PAGES, *REFERENCE}


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "docs/model-card.md",
        "docs/network.md",
        "docs/training.md",
        "docs/notes/network.md",
        "docs/notes/training.md",
    ],
)
def test_every_table_of_figures_names_the_command_that_makes_it(page):
    """`<!-- figures: COMMAND -->` stands before each table with decimals that are measured, not
    set.
    """
    text = (ROOT / page).read_text(encoding="utf-8")
    for table in re.finditer(r"(?m)(?:^\|.*\n)+", text):
        if re.search(r"\| (setting|recipe) \|", table[0]) or not re.search(
            r"\d\.\d", table[0]
        ):
            continue
        named = re.search(
            r"<!-- figures: (edit3r|python) (\S+) .*-->\n$", text[: table.start()]
        )
        assert named, f"{page}: no command before the table {table[0][:80]}"
        program, what = named.groups()
        assert (
            what in generate.commands()
            if program == "edit3r"
            else (ROOT / what).is_file()
        ), f"{page}: {what}"


NOT_MEASURED = (
    r"`[^`]*`|<!--.*?-->|\(#?[\w./-]+\)|(Apache-|BY-NC-SA |section |torch |at "
    r"least |above |\^)[\d.]+\S*"
)
"""Decimals that nobody measured: settings and paths, licences, versions, limits."""


@pytest.mark.parametrize(
    "page",
    ["README.md", "docs/model-card.md", "docs/network.md", "docs/notes/network.md"],
)
def test_every_figure_in_a_sentence_stands_in_a_table_or_beside_its_command(page):
    text = re.sub(
        r"```.*?```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL
    )
    tables = "".join(table[0] for table in re.finditer(r"(?m)(?:^\|.*\n)+", text))
    known = set(re.findall(r"\d+\.\d+", tables))
    for paragraph in re.split(r"\n\s*\n", re.sub(r"(?m)^\|.*\n", "", text)):
        if re.search(r"`(edit3r|python) [^`]+`|\[figures\]\(", paragraph):
            continue
        found = set(re.findall(r"\d+\.\d+", re.sub(NOT_MEASURED, "", paragraph)))
        assert found <= known, (
            f"{page}: no command makes {sorted(found - known)} in: {paragraph.strip()[:100]}"
        )


def test_links_between_pages_lead_somewhere():
    pages = {**PAGES, **REFERENCE}
    for page, text in pages.items():
        for target, anchor in LINK.findall(_without_code(text)):
            if "://" in target:
                continue
            resolved = (DOCS / page).parent.joinpath(target).resolve()
            if not target:
                resolved = (DOCS / page).resolve()
            name = str(resolved).removeprefix(f"{DOCS.resolve()}/")
            assert resolved.exists() or name in pages, (
                f"docs/{page} links to {target}, which is not there"
            )
            assert not anchor or anchor in _anchors(pages[name]), (
                f"docs/{page} links to {name}#{anchor}, which has no such heading"
            )


def _anchors(text: str) -> set[str]:
    """What mkdocs calls the headings of a page in its links."""
    headings = re.findall(r"(?m)^#+ (.+)$", text)
    return {slugify(re.sub(r"[`*]", "", heading), "-") for heading in headings}


MAX_WORDS = 900


def test_pages_for_users_are_short():
    """What was tried and measured stands in docs/notes; tables and code are not counted."""
    made = r"^```.*?^```|<!--.*?-->|^ *\|.*?$|^Measured at `.*?$"
    for page in (page for page in PAGES if "/" not in page):
        words = len(re.sub(f"(?ms){made}", "", PAGES[page]).split())
        assert words <= MAX_WORDS, (
            f"docs/{page} has {words} words; move some to docs/notes"
        )


SHIPPED_BINARIES = {".jpg", ".png", ".svg", ".safetensors"}


def test_the_notice_names_every_image_and_all_weights_in_the_repository():
    notice = (ROOT / "NOTICE").read_text(encoding="utf-8")
    for folder in ("docs", "edit3r", "edit3r_testing", "plugins", "examples"):
        for file in (ROOT / folder).rglob("*"):
            if file.suffix in SHIPPED_BINARIES:
                assert file.name in notice, f"NOTICE does not name {file}"


# ---- what is shown is true ----

PLACES = re.findall(
    r"^\| (.+?) \| `([\w/.]+)` \| `([\w.]+)` \|$",
    PAGES["architecture.md"],
    re.MULTILINE,
)


def test_the_architecture_page_answers_where_thirty_things_are():
    assert len(PLACES) >= 30 and len({what for what, _, _ in PLACES}) == len(PLACES)


def test_the_places_that_the_architecture_page_names_are_there():
    for what, file, symbol in PLACES:
        assert (ROOT / file).is_file(), f"{file} is gone; where is {what}?"
        scope = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
        for name in symbol.split("."):
            found = [node for node in scope if name in _names_of(node)]
            assert found, f"{file} has no {symbol}; where is {what}?"
            scope = getattr(found[0], "body", [])


NAMED_PAGES = ("architecture.md", "plugins/editor.md")


@pytest.mark.slow
@pytest.mark.parametrize("page", NAMED_PAGES)
def test_every_file_and_symbol_that_a_page_names_exists(page):
    """Each text between backticks that is a path, or a name as Python writes it."""
    named = re.findall(r"`([^`\n]+)`", re.sub(r"(?s)```.*?```", "", PAGES[page]))
    for text in named:
        if re.fullmatch(r"[\w./]+/[\w./]*|[\w/]+\.(?:py|yaml|md)", text):
            assert _is_path(text), f"{page} names {text}, which is not there"
        elif re.fullmatch(r"[A-Za-z_]\w*(?:\.\w+)*(?:\(.*\))?", text):
            assert _is_known(text), f"{page} names {text}, which nothing defines"


def _is_path(text: str) -> bool:
    """Whether a path, from the root or from any room of the core or a plugin, is there."""
    written = {"inputs/", "edited/", "renders/", "masks/"}
    homes = (ROOT, ROOT / "edit3r", ROOT / "edit3r/kit", *_rooms())
    return text in written or any((home / text).exists() for home in homes)


@cache
def _rooms() -> list[Path]:
    return [
        folder
        for home in ("edit3r", "plugins")
        for folder in (ROOT / home).rglob("*")
        if folder.is_dir()
    ]


def _is_known(text: str) -> bool:
    """Whether the last name of a dotted one stands in the sources as a word."""
    name = text.split("(")[0].split(".")[-1]
    return re.search(rf"\b{name}\b", _sources()) is not None


@cache
def _sources() -> str:
    files = [
        file
        for home in ("edit3r", "edit3r_testing", "plugins")
        for file in (ROOT / home).rglob("*.py")
    ]
    names = " ".join(file.stem for file in files)
    return names + "".join(file.read_text(encoding="utf-8") for file in files)


def _names_of(node: ast.stmt) -> set[str]:
    """Names that a statement defines."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        return {node.name}
    targets = (
        node.targets
        if isinstance(node, ast.Assign)
        else [getattr(node, "target", None)]
    )
    return {target.id for target in targets if isinstance(target, ast.Name)}


def test_the_generated_parts_of_the_pages_are_current():
    for name, text in PAGES.items():
        assert generate.refreshed(text) == text, (
            f"docs/{name} is out of date; run: python docs/generate.py"
        )


@pytest.fixture(scope="module")
def example_folders(tmp_path_factory):
    """The packages of the plugin pages, written as the pages show them; kind to package folder."""
    parent = tmp_path_factory.mktemp("pages")
    folders = {}
    for kind in KINDS:
        for path, code in BLOCK.findall(PAGES[f"plugins/{kind}.md"]):
            target = parent / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(code, encoding="utf-8")
            if target.name == "__init__.py":
                folders[kind] = target.parent
    return folders


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_example_of_each_page_keeps_its_contract(kind, example_folders):
    folder = example_folders[kind]
    name = folder.name.removeprefix("edit3r_").replace("_", "-")
    settings = {"steps": 3} if kind == "trainer" else {}
    run_all_claims(contract_for(kind, name, (folder,), **settings))
    for module in [
        module for module in sys.modules if module.split(".")[0] == folder.name
    ]:
        # else `new-plugin` takes it for installed in the tests that follow
        del sys.modules[module]


@pytest.mark.slow
def test_the_learned_example_keeps_its_contracts():
    example = (ROOT / "examples/learned.py",)
    run_all_claims(contract_for("reconstructor", "learned", example))
    run_all_claims(contract_for("head", "curtain", example))


@pytest.mark.parametrize("page", ["quickstart.md", "concepts.md"])
def test_configurations_shown_are_accepted(page):
    from edit3r.running.config import make_run_config

    blocks = re.findall(r"```yaml\n(.*?)```", PAGES[page], re.DOTALL)
    assert blocks
    for block in blocks:
        make_run_config(yaml.safe_load(block))


def test_options_shown_exist():
    """Every `edit3r COMMAND ... --option` in a shell block is an option of that command."""
    helps: dict[str, str] = {}  # a command's own, and those of its steps
    shown = re.findall(
        r"## `edit3r ([\w-]+)[^`]*`.*?```text\n(.*?)```",
        REFERENCE["reference/commands.md"],
        re.DOTALL,
    )
    for command, help_text in shown:
        helps[command] = helps.get(command, "") + help_text
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for page, text in {**PAGES, "README.md": readme}.items():
        for command, options in _commands_shown(text):
            assert command in helps, f"{page}: no command edit3r {command}"
            for option in options:
                assert option in helps[command], (
                    f"{page}: edit3r {command} has no {option}"
                )


def _commands_shown(text: str) -> Iterator[tuple[str, list[str]]]:
    """Commands of the shell blocks of a page, each with its options."""
    for language, block in re.findall(r"(?ms)^```(\w*).*?\n(.*?)^```", text):
        if language not in ("", "sh", "bash"):
            continue
        lines = block.replace("\\\n", " ")
        for command, rest in re.findall(
            r"^(?:.*&& )?edit3r ([\w-]+)(.*)$", lines, re.MULTILINE
        ):
            yield command, re.findall(r"\s(--[\w-]+)", rest.split("#")[0])


def run_all_claims(contract):
    for claim in claims(contract):
        getattr(contract(), claim)()


def _leaves(tree):
    if isinstance(tree, str):
        yield tree
    for branch in (
        tree.values()
        if isinstance(tree, dict)
        else tree
        if isinstance(tree, list)
        else ()
    ):
        yield from _leaves(branch)


def _without_code(text: str) -> str:
    return re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL)
