import { dialog, go, isDark, setTheme } from "../state/app";
import { forget } from "../state/draft";

export function Header() {
  const dark = isDark();
  const home = () => {
    forget();
    go({ page: "start" });
  };
  return (
    <header>
      <button type="button" class="wordmark" onClick={home}>
        <svg viewBox="0 0 32 32" width="22" height="22" aria-hidden="true">
          <g fill="none" stroke="currentColor" stroke-linecap="round">
            <path d="M3 21c5-12 10-12 13-6s8 6 13-6" stroke-width="2.6" />
            <path d="M3 27c5-12 10-12 13-6s8 6 13-6" stroke-width="1.3" opacity=".5" />
            <path d="M3 15c5-12 10-12 13-6s8 6 13-6" stroke-width="1.3" opacity=".5" />
          </g>
        </svg>
        udflow
      </button>
      <nav aria-label="Page">
        <button type="button" onClick={() => show("jobs")}>
          Jobs
        </button>
        <button type="button" onClick={() => setTheme(dark ? "light" : "dark")}>
          {dark ? "Light" : "Dark"}
        </button>
        <button type="button" onClick={() => show("help")} aria-label="Keys and help">
          ?
        </button>
      </nav>
    </header>
  );
}

function show(name: "jobs" | "help"): void {
  dialog.value = name;
}
