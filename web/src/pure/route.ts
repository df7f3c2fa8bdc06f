/** The address says what is shown: nothing yet, or a job. Kept behind "#", so that the page may be
 * served under any path. */

import { UPS, type Up } from "./up";

/** up: which way the picture stands; left out where it is z. */
export type Route = { page: "start" } | { page: "job"; id: string; up?: Up };

/** The route of `location.hash`; whatever is no job id leads to the start. */
export function routeOf(hash: string): Route {
  const found = /^#\/jobs\/(job_[0-9a-z]{1,64})(?:\?up=([-xyz]{1,2}))?$/.exec(hash);
  if (!found) return { page: "start" };
  const up = UPS.find((each) => each === found[2]);
  return up ? { page: "job", id: found[1], up } : { page: "job", id: found[1] };
}

/** The inverse of `routeOf`. */
export function hashOf(route: Route): string {
  if (route.page === "start") return "#/";
  return `#/jobs/${route.id}${route.up && route.up !== "z" ? `?up=${route.up}` : ""}`;
}
