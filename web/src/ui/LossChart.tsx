import { useEffect, useRef } from "preact/hooks";
import type uPlot from "uplot";
import { isDark } from "../state/app";
import { losses } from "../state/job";

/** Loss over seconds, on a logarithmic scale. */
export function LossChart() {
  const host = useRef<HTMLDivElement>(null);
  const chart = useRef<uPlot | null>(null);
  const points = losses.value;
  const started = points[0]?.seconds ?? 0;
  const data: uPlot.AlignedData = [
    points.map((each) => each.seconds - started),
    points.map((each) => each.loss),
  ];
  useEffect(() => {
    let gone = false;
    void import("./chart").then(({ lossChart }) => {
      if (gone || !host.current) return;
      chart.current = lossChart(host.current, data);
    });
    return () => {
      gone = true;
      chart.current?.destroy();
      chart.current = null;
    };
  }, [isDark()]);
  useEffect(() => chart.current?.setData(data), [points]);
  const last = points.at(-1)?.loss ?? 0;
  return (
    <div
      ref={host}
      class="chart"
      role="img"
      aria-label={`Loss after ${points.length} fits, now ${last.toExponential(2)}`}
    />
  );
}
