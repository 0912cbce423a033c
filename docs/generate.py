"""The pages that are made from the code: the reference, and the examples on the plugin pages.

The reference (hooks, components with their settings, commands, Python) and, at the end of each
plugin's page, its example and what its contract asks are built with the site and never checked in:
mkdocs calls `on_files` and `on_page_markdown`. Tables stand in their pages, between markers:

    # rewrite the marked parts of docs/combinations.md, docs/files.md, docs/results.md,
    # docs/plugins/testing.md and docs/plugins/directory.md from what components declare and
    # benchmarks measured
    python docs/generate.py
    python docs/generate.py DIR        also write the reference pages into DIR
"""

import argparse
import importlib
import inspect
import json
import re
from collections.abc import Iterator
from pathlib import Path

import edit3r
from edit3r.cli.main import COMMANDS, find_command
from edit3r.contract.component import KINDS, Component, Offer, hook_name
from edit3r.contract.errors import Edit3rError
from edit3r.loading.describe import metadata_lines, settings_lines, yaml_example
from edit3r.loading.registry import Registry, default_registry

DOCS = Path(__file__).parent
MARKED = re.compile(r"(<!-- begin: (\w+) ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
PYTHON_MODULES = (
    "edit3r.contract.types",
    "edit3r.contract.interfaces",
    "edit3r.contract.component",
    "edit3r.contract.settings",
    "edit3r.loading.registry",
    "edit3r.contract.reporting",
    "edit3r.contract.errors",
    "edit3r.kit.geometry.cameras",
    "edit3r.kit.geometry.rotations",
    "edit3r.kit.geometry.harmonics",
    "edit3r.kit.geometry.maps",
    "edit3r_testing",
)
"""Modules a plugin author or a script may import from."""


def reference_pages(registry: Registry) -> dict[str, str]:
    """Path below docs/ to Markdown of every page of the reference."""
    pages = {
        "reference/hooks.md": hooks_page(),
        "reference/commands.md": commands_page(),
    }
    for kind in KINDS:
        pages[f"reference/components/{kind}.md"] = components_page(registry, kind)
    pages["reference/run.md"] = run_page()
    pages["reference/python.md"] = python_page()
    return pages


def hooks_page() -> str:
    """Every hook with its sentence and the interface its components follow."""
    from edit3r.contract import hookspecs
    from edit3r.contract.interfaces import INTERFACES

    rows = []
    for kind in KINDS:
        hook = hook_name(kind)
        sentence = inspect.getdoc(getattr(hookspecs, hook)).splitlines()[0]
        rows.append(
            f"| [{kind}](../plugins/{kind}.md) | `{hook}` | {sentence} | "
            f"`{INTERFACES[kind].__name__}` |"
        )
    table = "\n".join(
        [
            "| kind | hook | what it offers | interface |",
            "| --- | --- | --- | --- |",
            *rows,
        ]
    )
    about = inspect.getdoc(hookspecs)
    return f"# Hooks\n\n{about}\n\nAPI version {hookspecs.API_VERSION}.\n\n{table}\n"


def components_page(registry: Registry, kind: str) -> str:
    """Every installed component of a kind: what to know, and its settings."""
    sections = [component_section(registry, offer) for offer in registry.offers(kind)]
    intro = (
        f"What this installation offers; see [writing one](../../plugins/{kind}.md)."
    )
    return (
        "\n\n".join([f"# {kind.title()} components", intro, *(sections or ["None."])])
        + "\n"
    )


def component_section(registry: Registry, offer: Offer) -> str:
    facts = "\n".join(
        f"- {what}: {value}" for what, value in metadata_lines(offer.component)
    )
    component = offer.component
    summary = f"Plugin {offer.plugin}: {component.summary}"
    head = f"## `{component.name}`\n\n{summary}\n\n{facts}"
    try:
        settings = registry.settings_class(offer)
    except Edit3rError as error:
        return f"{head}\n\nIts settings could not be read here: {error}"
    if not settings.model_fields:
        return f"{head}\n\nNo settings."
    return f"{head}\n\n{settings_table(settings)}\n\n```yaml\n{yaml_example(offer, settings)}\n```"


def settings_table(settings: type) -> str:
    rows = ["| setting | type | range | default | |", "| --- | --- | --- | --- | --- |"]
    for line in settings_lines(settings):
        kind = line.type.replace("|", "\\|")
        default = "required" if line.required else f"`{line.default_yaml}`"
        rows.append(
            f"| `{line.name}` | {kind} | {line.range} | {default} | {line.sentence} |"
        )
    return "\n".join(rows)


def run_page() -> str:
    """The top-level keys of a run's configuration."""
    from edit3r.running.config import RunConfig

    return f"# Run configuration\n\n{inspect.getdoc(RunConfig)}\n\n{settings_table(RunConfig)}\n"


def commands_page() -> str:
    """The help of every command."""
    sections = ["# Commands"]
    for name, summary in commands().items():
        parser = argparse.ArgumentParser(prog=f"edit3r {name}", formatter_class=_Narrow)
        find_command(name).add_arguments(parser)
        sections.append(
            f"## `edit3r {name}`\n\n{summary[0].upper()}{summary[1:]}.\n\n"
            f"```text\n{parser.format_help()}```"
        )
        sections += _steps_of(name, parser)
    return "\n\n".join(sections) + "\n"


def _steps_of(name: str, parser: argparse.ArgumentParser) -> list[str]:
    """The help of `edit3r NAME STEP` for a command that is made of steps."""
    sections = []
    for action in parser._actions:
        for step, inner in (
            action.choices.items()
            if isinstance(action, argparse._SubParsersAction)
            else ()
        ):
            inner.formatter_class = _Narrow
            sections.append(
                f"## `edit3r {name} {step}`\n\n```text\n{inner.format_help()}```"
            )
    return sections


def commands() -> dict[str, str]:
    """Command name to its summary: the core's own, then those of plugins."""
    offered = [offer.component for offer in default_registry().offers("command")]
    return {component.name: component.summary for component in (*COMMANDS, *offered)}


class _Narrow(argparse.HelpFormatter):
    """The same width on every machine."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=100)


def python_page() -> str:
    """Public classes and functions with their docstrings; data classes and interfaces as written,
    comments and all.
    """
    sections = [
        "# Python",
        "Names that `edit3r` itself offers: "
        + ", ".join(f"`{n}`" for n in edit3r.__all__)
        + ".",
    ]
    for name in PYTHON_MODULES:
        module = importlib.import_module(name)
        sections.append(f"## `{name}`\n\n{inspect.getdoc(module)}")
        sections += [
            _described(name, thing, value) for thing, value in public_things(module)
        ]
    return "\n\n".join(sections) + "\n"


def public_things(module: object) -> Iterator[tuple[str, object]]:
    """Classes and functions that a module defines, or lists in `__all__`, without an underscore in
    front.
    """
    listed = getattr(module, "__all__", None)
    for name, value in vars(module).items():
        own = getattr(value, "__module__", "") == module.__name__ or (
            listed is not None and name in listed
        )
        if (
            own
            and not name.startswith("_")
            and (inspect.isclass(value) or inspect.isfunction(value))
        ):
            yield name, value


def _described(module: str, name: str, value: object) -> str:
    if inspect.isclass(value) and (
        hasattr(value, "__dataclass_fields__") or module == "edit3r.contract.interfaces"
    ):
        return f"### `{name}`\n\n```python\n{inspect.getsource(value).rstrip()}\n```"
    text = inspect.getdoc(value) or ""
    if inspect.isfunction(value):
        return f"### `{name}`\n\n```python\n{name}{inspect.signature(value)}\n```\n\n{text}"
    methods = [
        f"- `{method}{inspect.signature(function)}`: "
        f"{(inspect.getdoc(function) or '').splitlines()[0]}"
        for method, function in vars(value).items()
        if inspect.isfunction(function)
        and not method.startswith("_")
        and function.__doc__
    ]
    return "\n\n".join(
        part for part in (f"### `{name}`", text, "\n".join(methods)) if part
    )


# ---- the marked parts of the plugin pages ----


def refreshed(page: str) -> str:
    """The page with its marked parts made anew: `begin: claims KIND`, and tables."""
    makers = {
        "claims": claims_part,
        "parts": parts_part,
        "writers": writers_part,
        "directory": directory_part,
        "results": results_part,
    }
    return MARKED.sub(lambda m: m[1] + makers[m[2]](m[3]) + m[4], page)


EXAMPLE = re.compile(
    r"`edit3r new-plugin (\w+) ([\w-]+)` writes a\s\[complete example\]\(([^)]*)\)"
)


def completed(page: str) -> str:
    """A plugin's page with its example, how to try it, and what its contract asks."""
    found = EXAMPLE.search(page)
    if not found:
        return page
    kind, name, link = found.groups()
    sections = [
        page.replace(link, "#a-complete-example").rstrip(),
        f"## A complete example\n{example_part(kind, name)}",
        "## What the contract asks",
        "Beside [what all contracts ask](testing.md#what-all-contracts-ask):",
        claims_part(kind),
    ]
    return "\n\n".join(sections)


def example_part(kind: str, name: str) -> str:
    """The modules that `edit3r new-plugin KIND NAME` writes, and how to use them."""
    from edit3r_develop.new_plugin import next_steps, package_files

    files = {
        path: text
        for path, text in package_files(kind, name).items()
        if path.endswith(".py") and not path.startswith("tests/")
    }
    blocks = [
        f'```python title="edit3r-{name}/{path}"\n{text}```'
        for path, text in files.items()
    ]
    steps = "\n".join(next_steps(kind, name, Path(f"edit3r-{name}")))
    return "\n" + "\n\n".join([*blocks, f"```console\n{steps}\n```"]) + "\n"


def claims_part(kind: str) -> str:
    """What the contract of a kind asks beside what all ask, or (`common`) what all ask."""
    from edit3r_testing import CONTRACTS, Contract, claims

    contract = CONTRACTS.get(kind, Contract)
    common = claims(Contract)
    rows = []
    for claim in claims(contract):
        if claim in common and contract is not Contract:
            continue
        sentence = (
            inspect.getdoc(vars(contract).get(claim))
            if claim in vars(contract)
            else None
        )
        sentence = (sentence or inspect.getdoc(getattr(contract, claim)) or "").split(
            "\n"
        )[0]
        rows.append(
            f"- {claim.removeprefix('test_').replace('_', ' ')}"
            + (f": {sentence}" if sentence else "")
        )
    return "\n" + "\n".join(rows) + "\n\n"


# ---- the tables of docs/combinations.md and docs/files.md ----


def own_components(kind: str) -> list[Component]:
    """Components of the plugins in this repository, whatever else is installed."""
    own = {folder.name for folder in (DOCS.parent / "plugins").iterdir()}
    return [
        offer.component
        for offer in default_registry().offers(kind)
        if offer.module.partition(".")[0] in own
    ]


def measured() -> dict:
    """What `python benchmarks/speed.py combinations` left."""
    return json.loads(
        (DOCS.parent / "benchmarks" / "combinations.json").read_text(encoding="utf-8")
    )


def parts_part(kind: str) -> str:
    """Weights and what was tried, of every component of a kind; what a run costs where measured."""
    costs = seconds_of(kind)
    heads = ["name", "weights: MB, licence, commercial use", "run with"]
    heads += ["CPU s"] if costs else []
    rows = [_row(heads), _row(["---"] * len(heads))]
    for component in own_components(kind):
        weights = [
            f"`{one.name}`: {one.size / 1e6:,.0f}, {one.licence}, **{one.commercial}**"
            for one in component.weights
        ]
        elsewhere = "by the name you give, or a service" * component.needs_network
        name = f"`{component.name}`"
        cells = [name, "<br>".join(weights) or elsewhere, tried(kind, component)]
        rows.append(_row(cells + [costs.get(component.name, "")] * bool(costs)))
    return "\n" + "\n".join(rows) + "\n\n"


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def seconds_of(kind: str) -> dict[str, str]:
    """CPU seconds of a whole run with each reconstructor; nothing for other kinds."""
    if kind != "reconstructor":
        return {}
    rows = [row for row in measured()["rows"] if row.get("matcher") == "classical"]
    return {
        row["recon"]: f"{row['edit'] + row['rest']:.1f}"
        for row in rows
        if row["editor"] == "looks"
    }


def writers_part(kind: str) -> str:
    """What each writer leaves in the folder of a run, and what for."""
    rows = [_row(["name", "writes", "what for"]), _row(["---"] * 3)]
    for one in own_components(kind):
        rows.append(_row([f"`{one.name}`", f"`{one.file_name()}`", one.summary]))
    return "\n" + "\n".join(rows) + "\n\n"


def directory_part(kind: str) -> str:
    """The plugins that others published."""
    from edit3r_develop.directory import listed

    heads = ["package", "offers", "what it does", "licence", "edit3r, API", "install"]
    rows = [_row(heads), _row(["---"] * len(heads))]
    for one in listed(None if kind == "all" else kind):
        offers = [f"{k} `{name}`" for k, names in one.offers.items() for name in names]
        cells = [one.name, "<br>".join(offers), one.does, one.licence]
        rows.append(_row([*cells, f"{one.tested_with}, {one.api}", f"`{one.install}`"]))
    return "\n" + "\n".join(rows) + "\n\n"


def results_part(_: str) -> str:
    """A row a method and scene, then each method with its picture; those without figures last."""
    from edit3r_bench.report import MEASURES
    from edit3r_bench.results import SHOWN, read_method_results

    methods = read_method_results(DOCS / "results")
    measures = {
        name.replace("-", "_"): (f"{name} {MEASURES[name].better}", MEASURES[name].form)
        for name in SHOWN
    }
    forms = {"cpu_seconds": ("CPU s ↓", ".2f"), "memory_mb": ("MiB ↓", ".0f")}
    forms |= {"gaussians": ("Gaussians", "d")} | measures
    rows = [one for method in methods.values() for one in method.rows]
    forms = {n: v for n, v in forms.items() if any(getattr(r, n) for r in rows)}
    heads = [
        "method",
        "scene and edit",
        "verdict",
        *(title for title, _ in forms.values()),
    ]
    lines = [_row(heads), _row(["---"] * 3 + ["--:"] * len(forms))]
    about = []
    for name, method in sorted(methods.items(), key=lambda one: bool(one[1].missing)):
        link = f"[{method.method}]({method.link})"
        for row in method.rows:
            values = [(getattr(row, name), form) for name, (_, form) in forms.items()]
            cells = ["-" if v is None else format(v, form) for v, form in values]
            lines.append(_row([link, row.scene, row.verdict, *cells]))
        how = method.missing or f"{method.hardware}, {method.measured}"
        about.append(f"- **{link}**: {method.about}; {how}.")
        if (DOCS / f"results/{name}.webp").is_file():
            about.append(f"\n    ![{method.method}](results/{name}.webp)\n")
    return "\n" + "\n".join([*lines, "", *about]) + "\n\n"


def tried(kind: str, component: Component) -> str:
    """What it ran with where most was real, in the words that stand above the tables."""
    found, key = measured(), {"reconstructor": "recon"}.get(kind, kind)
    shown = any(
        row.get(key, "").partition(" ")[0] == component.name and "error" not in row
        for row in found["rows"]
    )
    if shown:
        return "photos"
    if component.weights:
        return "random weights"
    return "a fake service" if component.needs_network else "tests"


SCENES = DOCS / "scenes"
SCENE = """## {prompt}

<iframe data-src="{name}.html" title="{prompt}" allowfullscreen
 style="width: 100%; aspect-ratio: 3 / 2; border: 0; border-radius: 6px"></iframe>

Selected: {selected}, edit: {edit}, scene: {scene}. [All of the window]({name}.html).

```sh
{command}
```
"""
DRAWN_WHEN_LOOKED_AT = """
<script>
const looked = new IntersectionObserver((entries) => {
  for (const { isIntersecting, target } of entries)
    if (isIntersecting && !target.src) target.src = target.dataset.src;
});
for (const frame of document.querySelectorAll("iframe[data-src]")) looked.observe(frame);
</script>
"""
"""`loading="lazy"` begins with four: the first is there after ten seconds, this way after three."""


def scenes_part() -> str:
    """The viewers that `python docs/gallery.py docs/scenes --pages` made."""
    made = SCENES / "scenes.json"
    if not made.is_file():
        return "*They are not in this copy of the site.*"
    shown = json.loads(made.read_text(encoding="utf-8"))
    return "\n".join(SCENE.format(**one) for one in shown) + DRAWN_WHEN_LOOKED_AT


def on_page_markdown(markdown, page, config, files):
    """mkdocs hands over the text of a page: complete that of a plugin, show what was made."""
    return completed(markdown).replace("<!-- scenes -->", scenes_part())


def on_files(files, config):
    """mkdocs asks for the site's files: add the reference."""
    from mkdocs.structure.files import File

    for path, text in reference_pages(default_registry()).items():
        files.append(File.generated(config, path, content=text))
    return files


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reference", nargs="?", type=Path, help="folder of its pages")
    reference = parser.parse_args().reference
    marked = ("combinations", "files", "results")
    for page in (*marked, "plugins/testing", "plugins/directory"):
        path = DOCS / f"{page}.md"
        text = path.read_text(encoding="utf-8")
        path.write_text(refreshed(text), encoding="utf-8")
    if reference:
        for path, text in reference_pages(default_registry()).items():
            target = reference / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
