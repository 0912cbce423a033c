// Addresses of pages, which can be kept and sent.
export function go(address) {
  history.pushState(null, "", address);
  dispatchEvent(new PopStateEvent("popstate"));
}
export const sceneAddress = (scene, at = "", beside = "") => {
  const query = new URLSearchParams({
    ...(at && at !== scene ? { at } : {}),
    ...(beside ? { beside } : {}),
  });
  return `/s/${encodeURIComponent(scene)}${query.size ? "?" + query : ""}`;
};
