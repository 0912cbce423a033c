"""What every page is asked, on a desktop and a phone, dark and light."""

import os
from pathlib import Path

AXE_FILE = os.environ.get("EDIT3R_AXE", "")  # axe.min.js of the npm package axe-core
WIDE, PHONE = (1440, 900), (390, 844)
EVERY_LOOK = [(size, theme) for size in (WIDE, PHONE) for theme in ("dark", "light")]
LOOKS = [(WIDE, "dark"), (PHONE, "light")]
if os.environ.get("EDIT3R_EVERY_LOOK"):
    LOOKS = EVERY_LOOK
"""For what takes long: half of the looks, or all with EDIT3R_EVERY_LOOK=1."""
CUT_OFF = """(names) => names.flatMap((name) => [...document.querySelectorAll(name)])
  .filter((one) => one.checkVisibility())
  .filter((one) => {
    const {overflowY, overflowX} = getComputedStyle(one), scrolls = ["auto", "scroll"];
    const area = one.getBoundingClientRect();
    return (one.scrollHeight > one.clientHeight + 1 && !scrolls.includes(overflowY))
      || (one.scrollWidth > one.clientWidth + 1 && !scrolls.includes(overflowX))
      || area.left < -1 || area.right > innerWidth + 1
      || area.top < -1 || area.bottom > innerHeight + 1;
  })
  .map((one) => (one.className || one.id || one.tagName) + ": " + one.textContent)"""


def id_of(look):
    (width, _), theme = look
    return f"{width}-{theme}"


def cut_off(page, names):
    """Of the elements that are shown those whose text cannot be read whole."""
    return page.evaluate(CUT_OFF, list(names))


def serious(page):
    """What axe finds that is serious or critical; nothing where it is not there."""
    if not AXE_FILE:
        return []
    page.evaluate(Path(AXE_FILE).read_text(encoding="utf-8"))
    found = page.evaluate("axe.run(document, {iframes: false})")["violations"]
    return [
        (one["id"], one["nodes"][0]["html"])
        for one in found
        if one["impact"] in ("serious", "critical")
    ]
