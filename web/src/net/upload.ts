/** Bringing a file to the service: in pieces that can be resumed (tus 1.0) where the service
 * takes them, else in one go. */

import { address, keyHeaders, Problem, problemOf, type ScanInfo } from "./api";

export interface UploadState {
  sent: number;
  total: number;
  /** Bytes a second, of late; null at the beginning. */
  speed: number | null;
  paused: boolean;
  /** Every byte is there; the service reads the file. */
  reading: boolean;
}

const PIECE = 4 << 20;
const TRIES = 8;
const TUS = { "Tus-Resumable": "1.0.0" };

export class Upload {
  private request: XMLHttpRequest | null = null;
  private readonly speed = new Speed();
  private stopped = false;
  private resume: (() => void) | null = null;
  private state: UploadState;

  constructor(
    private readonly file: Blob,
    private readonly name: string,
    private readonly onState: (state: UploadState) => void,
  ) {
    this.state = { sent: 0, total: file.size, speed: null, paused: false, reading: false };
  }

  /** The scan, once it is there.
   * @throws Problem when the service does not want it; DOMException when it was stopped.
   */
  async run(): Promise<ScanInfo> {
    const place = await this.begin();
    return place === null ? this.inOneGo() : this.inPieces(place);
  }

  pause(): void {
    this.set({ paused: true, speed: null });
    this.request?.abort();
  }

  goOn(): void {
    this.set({ paused: false });
    this.resume?.();
  }

  stop(): void {
    this.stopped = true;
    this.request?.abort();
    this.resume?.();
  }

  /** Where the pieces go: an upload that was begun earlier, or a new one. */
  private async begin(): Promise<string | null> {
    const known = localStorage.getItem(this.mark());
    if (known !== null && (await this.offset(known).catch(() => null)) !== null) return known;
    const name = btoa(String.fromCharCode(...new TextEncoder().encode(this.name)));
    const answer = await this.send("POST", address("v1/uploads"), null, {
      ...TUS,
      "Upload-Length": String(this.file.size),
      "Upload-Metadata": `filename ${name}`,
    });
    if (answer.status === 404 || answer.status === 405) return null;
    if (answer.status !== 201) throw problemOf(answer.status, answer.responseText);
    const place = new URL(answer.getResponseHeader("Location") ?? "", address("v1/uploads"));
    const own = address(`v1/uploads/${place.pathname.split("/").pop()}`);
    localStorage.setItem(this.mark(), own);
    return own;
  }

  private async inPieces(place: string): Promise<ScanInfo> {
    for (let failures = 0; ; ) {
      await this.untilWanted();
      try {
        const found = await this.pieces(place);
        localStorage.removeItem(this.mark());
        return found;
      } catch (error) {
        if (this.stopped || this.state.paused) continue;
        if (error instanceof Problem && error.status !== 0 && error.status < 500) {
          localStorage.removeItem(this.mark());
          throw error;
        }
        if (++failures > TRIES) throw error;
        await new Promise((resolve) => setTimeout(resolve, 300 * 2 ** failures));
      }
    }
  }

  private async pieces(place: string): Promise<ScanInfo> {
    let offset = await this.offset(place);
    if (offset >= this.file.size) return this.finishedBefore(place);
    for (;;) {
      const until = Math.min(offset + PIECE, this.file.size);
      const answer = await this.send("PATCH", place, this.file.slice(offset, until), {
        ...TUS,
        "Content-Type": "application/offset+octet-stream",
        "Upload-Offset": String(offset),
      });
      if (answer.status >= 300) throw problemOf(answer.status, answer.responseText);
      offset = Number(answer.getResponseHeader("Upload-Offset") ?? until);
      this.set({ sent: offset });
      if (offset >= this.file.size) return this.finished(answer);
    }
  }

  private async finished(answer: XMLHttpRequest): Promise<ScanInfo> {
    const scan = (answer.getResponseHeader("Upload-Scan") ?? "").split("/").pop();
    return this.json(`v1/scans/${scan}`);
  }

  /** The last answer was lost: the upload knows what became of it. */
  private async finishedBefore(place: string): Promise<ScanInfo> {
    const about = await this.json<{ scan: ScanInfo | null; error: { message: string } | null }>(
      `v1/uploads/${place.split("/").pop()}`,
    );
    if (about.scan) return about.scan;
    throw new Problem(422, "invalid_cloud", about.error?.message ?? "The scan was not taken.");
  }

  private async json<T = ScanInfo>(path: string): Promise<T> {
    const answer = await this.send("GET", address(path), null, {});
    if (answer.status !== 200) throw problemOf(answer.status, answer.responseText);
    return JSON.parse(answer.responseText);
  }

  private async inOneGo(): Promise<ScanInfo> {
    for (;;) {
      await this.untilWanted();
      const url = address(`v1/scans?filename=${encodeURIComponent(this.name)}`);
      try {
        const answer = await this.send("POST", url, this.file, {
          "Content-Type": "application/octet-stream",
        });
        if (answer.status >= 300) throw problemOf(answer.status, answer.responseText);
        return JSON.parse(answer.responseText);
      } catch (error) {
        if (!this.state.paused) throw error;
      }
    }
  }

  private async offset(place: string): Promise<number> {
    const answer = await this.send("HEAD", place, null, TUS);
    const offset = Number(answer.getResponseHeader("Upload-Offset") ?? Number.NaN);
    if (answer.status >= 300 || Number.isNaN(offset)) {
      throw new Problem(answer.status, "upload_gone", "The upload was begun too long ago.");
    }
    this.set({ sent: offset });
    return offset;
  }

  private async untilWanted(): Promise<void> {
    if (this.state.paused && !this.stopped) {
      await new Promise<void>((resolve) => {
        this.resume = resolve;
      });
    }
    if (this.stopped) throw new DOMException("stopped", "AbortError");
  }

  private send(
    method: string,
    url: string,
    body: Blob | null,
    headers: Record<string, string>,
  ): Promise<XMLHttpRequest> {
    const request = new XMLHttpRequest();
    this.request = request;
    request.open(method, url);
    for (const [name, value] of Object.entries({ ...keyHeaders(), ...headers })) {
      request.setRequestHeader(name, value);
    }
    const before = this.state.sent;
    request.upload.onprogress = (event) => {
      const sent = before + event.loaded;
      this.set({ sent, speed: this.speed.at(performance.now() / 1000, sent) });
    };
    request.upload.onload = () => {
      if (this.state.sent >= this.file.size) this.set({ reading: true });
    };
    return new Promise((resolve, reject) => {
      const words = "The connection to the service broke off.";
      request.onload = () => resolve(request);
      request.onerror = () => reject(new Problem(0, "offline", words));
      request.onabort = () => reject(new DOMException("stopped", "AbortError"));
      request.send(body);
    });
  }

  private set(change: Partial<UploadState>): void {
    this.state = { ...this.state, ...change };
    this.onState(this.state);
  }

  private mark(): string {
    const { size } = this.file;
    const when = this.file instanceof File ? this.file.lastModified : 0;
    return `udflow.upload:${this.name}:${size}:${when}`;
  }
}

/** Bytes a second over the last seconds. */
class Speed {
  private seen: [number, number][] = [];

  at(now: number, sent: number): number | null {
    this.seen.push([now, sent]);
    while (this.seen[0][0] < now - 4) this.seen.shift();
    const [then, before] = this.seen[0];
    return now - then > 0.3 ? (sent - before) / (now - then) : null;
  }
}
