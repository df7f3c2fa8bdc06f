import "@fontsource/ibm-plex-sans/latin-400.css";
import "@fontsource/ibm-plex-sans/latin-600.css";
import "@fontsource/ibm-plex-mono/latin-400.css";
import "./style.css";
import { render } from "preact";
import { begin } from "./state/app";
import { App } from "./ui/App";

begin();
render(<App />, document.getElementById("app") as HTMLElement);
