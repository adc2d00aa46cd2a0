// The login: by a link, whose token stands behind the # and is sent to no server by the browser, or by hand.
const ANSWER_MS = 5000;
const THEMES = ["light", "dark", "night"];
const form = document.getElementById("login");
const field = document.getElementById("token");
const message = document.getElementById("message");
const button = form.querySelector("button");

// The page that was asked for stays behind the #, as in /#/map; it is never a token.
const wanted = () => (location.hash.startsWith("#/") ? location.hash : "");

function takeTheme() {
  try {
    const { theme } = JSON.parse(localStorage.getItem("obu-settings") ?? "{}");
    if (THEMES.includes(theme)) document.documentElement.dataset.theme = theme;
  } catch {
    // without settings the page follows the browser
  }
}

function takeToken() {
  const match = /^#token=([A-Za-z0-9_-]+)$/.exec(location.hash);
  if (location.hash.startsWith("#token=")) history.replaceState(null, "", "login"); // the token leaves the history
  return match?.[1] ?? null;
}

async function logIn(token) {
  button.disabled = true;
  message.textContent = "";
  try {
    const answer = await fetch("api/login", {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-OBU-CSRF": "login" },
      body: JSON.stringify({ token }),
      signal: AbortSignal.timeout(ANSWER_MS),
    });
    if (answer.ok) {
      location.replace(`./${wanted()}`);
      return;
    }
    message.textContent = answer.status === 401
      ? "This token is not valid. It was mistyped or revoked, has expired, or its link was used before."
      : `The unit refused the login: ${(await answer.json()).detail}`;
  } catch {
    message.textContent = "The unit does not respond. Check the connection, then try again.";
  }
  button.disabled = false;
  field.select();
}

async function begin() {
  takeTheme();
  const token = takeToken();
  if (token) return logIn(token);
  const session = await fetch("api/session").then((answer) => answer.json(), () => ({}));
  if (session.role) location.replace(`./${wanted()}`); // logged in already: a link from elsewhere sends no cookie
  else field.focus();
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  logIn(field.value.trim());
});
addEventListener("hashchange", () => {
  const token = takeToken();
  if (token) logIn(token);
});
begin();
