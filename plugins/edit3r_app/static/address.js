// Addresses of pages, which can be kept and sent.

// Where the app begins: "/", or below a path that a proxy serves it under.
export const ROOT = new URL("..", import.meta.url).pathname;
export function go(address) {
  history.pushState(null, "", address);
  dispatchEvent(new PopStateEvent("popstate"));
}
export const sceneAddress = (scene, at = "", beside = "") => {
  const query = new URLSearchParams({
    ...(at && at !== scene ? { at } : {}),
    ...(beside ? { beside } : {}),
  });
  return `${ROOT}s/${encodeURIComponent(scene)}${query.size ? "?" + query : ""}`;
};
