/** What is drawn over the canvas while selecting: the brush's ring, the box, the lasso. An SVG that takes no events. */

const NAMESPACE = "http://www.w3.org/2000/svg";

export class Overlay {
  private readonly svg: SVGSVGElement;
  private readonly ring: SVGCircleElement;
  private readonly line: SVGPolygonElement;

  constructor(host: HTMLElement) {
    this.svg = document.createElementNS(NAMESPACE, "svg");
    this.svg.classList.add("overlay");
    this.svg.setAttribute("aria-hidden", "true");
    this.ring = document.createElementNS(NAMESPACE, "circle");
    this.line = document.createElementNS(NAMESPACE, "polygon");
    this.svg.append(this.ring, this.line);
    host.append(this.svg);
    this.clear();
  }

  /** Shows the brush at a place. */
  brush(x: number, y: number, radius: number, erasing: boolean): void {
    this.ring.setAttribute("cx", String(x));
    this.ring.setAttribute("cy", String(y));
    this.ring.setAttribute("r", String(radius));
    this.ring.classList.toggle("erasing", erasing);
    this.ring.style.display = "";
  }

  /** Shows an outline of x, y pairs. */
  outline(points: readonly number[], erasing: boolean): void {
    this.line.setAttribute("points", points.map((x) => x.toFixed(1)).join(" "));
    this.line.classList.toggle("erasing", erasing);
    this.line.style.display = points.length > 0 ? "" : "none";
  }

  hideBrush(): void {
    this.ring.style.display = "none";
  }

  clear(): void {
    this.hideBrush();
    this.outline([], false);
  }
}
