// The login with name and password; the page that was asked for stays behind the #.
const ANSWER_MS = 10000;
const THEMES = ["light", "dark", "night"];
const form = document.getElementById("login");
const message = document.getElementById("message");
const button = form.querySelector("button");

const wanted = () => (location.hash.startsWith("#/") ? location.hash : "");

function takeTheme() {
  try {
    const { theme } = JSON.parse(localStorage.getItem("obu-settings") ?? "{}");
    if (THEMES.includes(theme)) document.documentElement.dataset.theme = theme;
  } catch {
    // without settings the page follows the browser
  }
}

async function logIn() {
  button.disabled = true;
  message.textContent = "";
  try {
    const answer = await fetch("api/login", {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-OBU-CSRF": "login" },
      body: JSON.stringify({ name: form.elements.username.value.trim(), password: form.elements.password.value }),
      signal: AbortSignal.timeout(ANSWER_MS),
    });
    if (answer.ok) {
      location.replace(`./${wanted()}`);
      return;
    }
    message.textContent = `The login was refused: ${(await answer.json()).detail}.`;
  } catch {
    message.textContent = "The centre does not respond. Check the connection, then try again.";
  }
  button.disabled = false;
  form.elements.password.select();
}

async function begin() {
  takeTheme();
  const session = await fetch("api/session").then((answer) => answer.json(), () => ({}));
  if (session.role) location.replace(`./${wanted()}`);
  else form.elements.username.focus();
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  logIn();
});
begin();
