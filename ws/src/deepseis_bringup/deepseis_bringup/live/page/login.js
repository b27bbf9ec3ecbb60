// A wall display's address may hold the token behind '#': that part is never sent, nor logged.

const token = decodeURIComponent(location.hash.replace(/^#token=/, ""));
if (location.hash.startsWith("#token=") && token) {
  history.replaceState(null, "", location.pathname);
  document.querySelector("#token").value = token;
  document.querySelector("form").submit();
}
