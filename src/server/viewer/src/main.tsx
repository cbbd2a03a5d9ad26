/** The page: the interface around a canvas. */

import { render } from "preact";
import "./style/tokens.css";
import "./style/layout.css";
import "./style/controls.css";
import { App } from "./ui/App.tsx";

const host = document.getElementById("app");
if (host !== null) render(<App />, host);
