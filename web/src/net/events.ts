/** Following a job: one websocket that comes back by itself, without loss or repeat. */

import { type Frame, readFrame } from "../pure/frame";
import { address, getTicket, hasKey, type Job, Problem } from "./api";

export interface JobEvent {
  id?: string;
  type: string;
  time: string;
  data: Record<string, unknown>;
}

export interface Listener {
  snapshot(job: Job): void;
  event(event: JobEvent): void;
  frame(frame: Frame): void;
  /** Whether the service is heard now. */
  live(live: boolean): void;
  /** No more will come. */
  ended(): void;
  failed(problem: Problem): void;
}

const ENDED_CODE = 1000;
const UNKNOWN_CODE = 4404;
const FIRST_PAUSE_MS = 400;
const LONGEST_PAUSE_MS = 8000;

/** Follows a job until its end. Returns a function that stops it. */
export function follow(id: string, listener: Listener): () => void {
  const socket = new Socket(id, listener);
  void socket.start();
  return () => socket.stop();
}

class Socket {
  private socket: WebSocket | null = null;
  private after = "0-0";
  private pause = FIRST_PAUSE_MS;
  private timer = 0;
  private stopped = false;

  constructor(
    private readonly id: string,
    private readonly listener: Listener,
  ) {}

  async start(): Promise<void> {
    const url = new URL(address(`v1/jobs/${this.id}/events`));
    url.protocol = url.protocol.replace("http", "ws");
    url.search = `previews=binary&after=${this.after}`;
    try {
      if (hasKey()) url.searchParams.set("ticket", await getTicket());
    } catch (error) {
      this.refused(error as Problem);
      return;
    }
    if (this.stopped) return;
    this.socket = new WebSocket(url);
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = (message) => this.take(message.data);
    this.socket.onclose = (event) => this.closed(event.code);
  }

  stop(): void {
    this.stopped = true;
    clearTimeout(this.timer);
    this.socket?.close();
  }

  private take(data: string | ArrayBuffer): void {
    if (this.stopped) return;
    this.pause = FIRST_PAUSE_MS;
    this.listener.live(true);
    if (data instanceof ArrayBuffer) {
      this.listener.frame(readFrame(data));
      return;
    }
    const event: JobEvent = JSON.parse(data);
    if (event.id) this.after = event.id;
    if (event.type === "snapshot") this.listener.snapshot(event.data as unknown as Job);
    else if (event.type !== "heartbeat") this.listener.event(event);
  }

  private closed(code: number): void {
    if (this.stopped) return;
    if (code === ENDED_CODE) {
      this.listener.ended();
      return;
    }
    if (code === UNKNOWN_CODE) {
      const words = "There is no such job any more: it was deleted, or has expired.";
      this.listener.failed(new Problem(404, "job_not_found", words));
      return;
    }
    this.later();
  }

  /** No ticket: the key is wrong, or nobody answers. */
  private refused(problem: Problem): void {
    if (this.stopped) return;
    if (problem.status === 401 || problem.status === 403) this.listener.failed(problem);
    else this.later();
  }

  private later(): void {
    this.listener.live(false);
    this.timer = window.setTimeout(() => void this.start(), this.pause);
    this.pause = Math.min(2 * this.pause, LONGEST_PAUSE_MS);
  }
}
