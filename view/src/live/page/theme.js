// Dark or light: what the user chose on the page, or else what the system says.

export class Theme {
  // `apply` draws what has colours of its own again.
  constructor(apply) {
    this.apply = apply;
  }

  begin() {
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const wanted = () => this.stored() ?? (dark.matches ? "dark" : "light");
    dark.addEventListener("change", () => this.set(wanted()));
    this.set(wanted());
  }

  stored() {
    try {
      return localStorage.getItem("theme");
    } catch {
      return null;
    }
  }

  set(theme) {
    document.documentElement.dataset.theme = theme;
    this.apply();
  }

  change() {
    const theme = document.documentElement.dataset.theme === "light" ? "dark" : "light";
    try {
      localStorage.setItem("theme", theme);
    } catch {
      // Without storage it holds until the page is closed.
    }
    this.set(theme);
  }
}
