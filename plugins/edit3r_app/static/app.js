// Which page is shown: the first, or that of a scene.
import { go, ROOT } from "./address.js";
import { home } from "./home.js";
import { scenePage } from "./scene.js";

let leave = () => {};

function show() {
  leave();
  for (const open of document.querySelectorAll("dialog")) open.close();
  const query = new URLSearchParams(location.search),
    [kind, name] = location.pathname.slice(ROOT.length).split("/");
  const page = document.getElementById("page");
  leave =
    kind === "s"
      ? scenePage(page, decodeURIComponent(name), query.get("at") || "", query.get("beside") || "")
      : home(page);
}
addEventListener("popstate", show);
document.addEventListener("click", (event) => {
  // links of ours without loading the page anew
  const link = event.target.closest("a[data-ours]");
  if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  go(link.getAttribute("href"));
});
show();
