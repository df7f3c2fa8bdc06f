/** Following a job: one websocket that comes back by itself, without loss or repeat; where a key
 * is needed, which a browser's websocket cannot send, waiting requests instead. */

import { type Frame, readFrame } from "../pure/frame";
import { address, ENDED, hasKey, type Job, Problem, waitForJob } from "./api";

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
  const follower = hasKey() ? new Poller(id, listener) : new Socket(id, listener);
  follower.start();
  return () => follower.stop();
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

  start(): void {
    const url = new URL(address(`v1/jobs/${this.id}/events`));
    url.protocol = url.protocol.replace("http", "ws");
    url.search = `previews=binary&after=${this.after}`;
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
    this.listener.live(false);
    this.timer = window.setTimeout(() => this.start(), this.pause);
    this.pause = Math.min(2 * this.pause, LONGEST_PAUSE_MS);
  }
}

class Poller {
  private readonly abort = new AbortController();

  constructor(
    private readonly id: string,
    private readonly listener: Listener,
  ) {}

  start(): void {
    this.run();
  }

  stop(): void {
    this.abort.abort();
  }

  private async run(): Promise<void> {
    while (!this.abort.signal.aborted) {
      try {
        const job = await waitForJob(this.id, this.abort.signal);
        this.listener.live(true);
        this.listener.snapshot(job);
        if (ENDED.includes(job.state)) return this.listener.ended();
      } catch (error) {
        if (this.abort.signal.aborted) return;
        if (error instanceof Problem && error.status >= 400 && error.status < 500) {
          return this.listener.failed(error);
        }
        this.listener.live(false);
      }
      await new Promise((resolve) => setTimeout(resolve, 700));
    }
  }
}
