/** The address says what is shown: nothing yet, or a job. Kept behind "#", so that the page may be
 * served under any path. */

export type Route = { page: "start" } | { page: "job"; id: string };

/** The route of `location.hash`; whatever is no job id leads to the start. */
export function routeOf(hash: string): Route {
  const found = /^#\/jobs\/(job_[0-9a-z]{1,64})$/.exec(hash);
  return found ? { page: "job", id: found[1] } : { page: "start" };
}

/** The inverse of `routeOf`. */
export function hashOf(route: Route): string {
  return route.page === "job" ? `#/jobs/${route.id}` : "#/";
}
