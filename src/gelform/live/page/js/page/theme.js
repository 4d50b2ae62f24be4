// Light or dark: as the system has it until somebody chooses.

const KEY = "gelform-theme", system = matchMedia("(prefers-color-scheme: dark)");

export function startTheme(changed) {
  const apply = () => {
    document.documentElement.dataset.theme = localStorage.getItem(KEY) ?? (system.matches ? "dark" : "light");
    changed();
  };
  system.addEventListener("change", apply);
  apply();
  return () => {
    localStorage.setItem(KEY, document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    apply();
  };
}
