// Before anything is drawn: dark or light, as was chosen here, else as the system is.
document.documentElement.dataset.theme =
  localStorage.getItem("edit3r-theme") ||
  (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
