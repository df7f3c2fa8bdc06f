import { colorAt, css } from "../pure/colormap";
import { length } from "../pure/format";
import { bin } from "../pure/histogram";
import { compared } from "../state/job";
import { heat, heatTop, map } from "../state/look";

const BINS = 40;
const HEIGHT = 64;

/** How the distances are spread, in the colours of the heat map. */
export function Histogram() {
  const found = compared.value;
  if (!found) return null;
  const top = heatTop.value;
  const counts = bin(found.values, top, BINS);
  const most = Math.max(...counts);
  return (
    <figure class="histogram">
      <svg
        viewBox={`0 0 ${BINS} ${HEIGHT}`}
        preserveAspectRatio="none"
        role="img"
        aria-label={`Most points are nearer than ${length(found.summary.p95)}`}
      >
        {counts.map((number, i) => {
          const tall = (HEIGHT * number) / most;
          const place = i / (BINS - 1);
          const fill = heat.value ? css(colorAt(map.value, place)) : "currentColor";
          return (
            <rect
              key={place}
              x={i + 0.08}
              y={HEIGHT - tall}
              width={0.84}
              height={tall}
              fill={fill}
            />
          );
        })}
      </svg>
      <figcaption class="ends">
        <span>0</span>
        <span>{length(top)}</span>
      </figcaption>
    </figure>
  );
}
