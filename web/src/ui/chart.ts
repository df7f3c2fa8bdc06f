/** The loss chart; loaded when there is something to draw. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { colorNow } from "../state/app";

const HEIGHT = 132;

export function lossChart(host: HTMLElement, data: uPlot.AlignedData): uPlot {
  const [soft, line, accent] = ["--soft", "--line", "--accent"].map(colorNow);
  const font = "11px 'IBM Plex Mono', monospace";
  const axis = { stroke: soft, font, grid: { stroke: line, width: 1 }, ticks: { show: false } };
  return new uPlot(
    {
      width: host.clientWidth,
      height: HEIGHT,
      padding: [8, 16, 0, 0],
      legend: { show: false },
      cursor: { drag: { x: false, y: false }, points: { size: 6 } },
      scales: { x: { time: false }, y: isWide(data) ? { distr: 3 } : { range: widened } },
      axes: [
        { ...axis, size: 24, gap: 4, values: (_, ticks) => ticks.map((value) => `${value} s`) },
        { ...axis, size: 58, gap: 6, values: (_, ticks) => ticks.map(short) },
      ],
      series: [{}, { stroke: accent, width: 1.5, points: { size: 5, fill: accent } }],
    },
    data,
    host,
  );
}

/** Whether the loss spans so much that its powers of ten are what matters. */
function isWide(data: uPlot.AlignedData): boolean {
  const values = data[1] as number[];
  return Math.max(...values) > 8 * Math.min(...values);
}

/** From nothing, with a little room above: an even loss is to look even. */
function widened(_: uPlot, __: number, high: number): [number, number] {
  return [0, high * 1.25];
}

function short(value: number | null): string {
  if (value === 0) return "0";
  return value === null ? "" : value.toExponential(1).replace(".0e", "e");
}
