import { retryJob } from "../net/api";
import { go } from "../state/app";
import { failure } from "../state/job";
import { up } from "../state/look";

/** A new job like this one. */
export async function again(id: string): Promise<void> {
  try {
    const next = await retryJob(id);
    go({ page: "job", id: next.id, up: up.value });
  } catch (error) {
    failure.value = (error as Error).message;
  }
}
