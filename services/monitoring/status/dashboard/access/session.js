// The login of this page, and changes that the unit accepts from it.
import { signal } from "@preact/signals";

const ANSWER_MS = 5000;

export const session = signal(null); // as /api/session states it

export async function renew() {
  const answer = await fetch("/api/session", { signal: AbortSignal.timeout(ANSWER_MS) });
  if (answer.ok) session.value = await answer.json();
  return session.value;
}

// The page that is shown stays behind the #, so that the login comes back to it.
export const toLogin = () => location.replace(`/login${location.hash}`);

const post = (path, command) => fetch(path, {
  method: "POST",
  headers: { "Content-Type": "application/json", "X-OBU-CSRF": session.value?.csrf ?? "" },
  body: JSON.stringify(command),
  signal: AbortSignal.timeout(ANSWER_MS),
});

// Send a command. Its header proves that this page sends it; after a restart of the unit the value is another one.
export async function change(path, command) {
  if (!session.value) await renew();
  const used = session.value?.csrf;
  let answer = await post(path, command);
  if (answer.status === 403 && (await renew())?.csrf !== used) answer = await post(path, command);
  if (answer.status === 401) toLogin();
  return answer;
}

export async function logOut() {
  await change("/api/logout", {});
  location.replace("/login");
}
