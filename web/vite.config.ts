import { defineConfig } from "vitest/config";

// Relative addresses, so that the service may live under any path.
export default defineConfig({
  base: "./",
  build: {
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 800,
  },
  worker: { format: "es" },
  test: { include: ["tests/**/*.test.ts"] },
});
