// Talking with the server; what it refuses is thrown as a sentence.
import { ROOT } from "./address.js";

export const path = (...parts) => ROOT + parts.map(encodeURIComponent).join("/");

async function answer(response) {
  if (response.ok) return response.json();
  const text = await response.text();
  throw new Error(
    response.status < 500 || response.status === 507
      ? text
      : "Something went wrong in the app; its window says what.",
  );
}
async function reach(address, options) {
  try {
    return await fetch(address, options);
  } catch (error) {
    if (options?.signal?.aborted) throw error;
    throw new Error("The app does not answer; is it still running?");
  }
}
// The parts of an address, and at the end what its query says; `signal` aborts the request.
export async function ask(...parts) {
  const { signal, ...query } = typeof parts.at(-1) === "object" ? parts.pop() : {};
  return answer(await reach(`${path("api", ...parts)}?${new URLSearchParams(query)}`, { signal }));
}
export const tell = async (parts, body = {}) =>
  answer(
    await reach(path("api", ...parts), {
      method: "POST",
      body: JSON.stringify(body),
      headers: { "Content-Type": "application/json" },
    }),
  );
