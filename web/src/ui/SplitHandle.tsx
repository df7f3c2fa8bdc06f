import { useRef } from "preact/hooks";
import { result } from "../state/job";
import { split } from "../state/look";

/** The line between input and result. */
export function SplitHandle() {
  const handle = useRef<HTMLDivElement>(null);
  const share = split.value;
  if (share === null || !result.value) return null;
  const set = (value: number) => {
    split.value = Math.min(Math.max(value, 0.05), 0.95);
  };
  const move = (event: PointerEvent) => {
    if (!handle.current?.hasPointerCapture(event.pointerId)) return;
    const box = handle.current.parentElement?.getBoundingClientRect();
    if (box) set((event.clientX - box.left) / box.width);
  };
  const key = (event: KeyboardEvent) => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    set(share + step);
  };
  return (
    <>
      <span class="split-label" style={{ right: `calc(${100 - 100 * share}% + 14px)` }}>
        Scan
      </span>
      <span class="split-label" style={{ left: `calc(${100 * share}% + 14px)` }}>
        Mesh
      </span>
      <div
        ref={handle}
        class="split"
        role="slider"
        tabIndex={0}
        aria-label="Border between scan and mesh"
        aria-valuemin={5}
        aria-valuemax={95}
        aria-valuenow={Math.round(100 * share)}
        style={{ left: `${100 * share}%` }}
        onPointerDown={(event) => handle.current?.setPointerCapture(event.pointerId)}
        onPointerMove={move}
        onKeyDown={key}
      />
    </>
  );
}
