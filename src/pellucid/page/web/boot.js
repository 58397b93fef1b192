// Inflate the program, which stands in the file like its data, and run it: the policy of the page knows it by its hash.
(async () => {
  try {
    const text = /** @type {HTMLElement} */ (document.getElementById("code")).textContent ?? "";
    const packed = Uint8Array.from(atob(text.trim()), (character) => character.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const program = document.createElement("script");
    program.textContent = await new Response(stream).text();
    document.head.append(program);
  } catch {
    const message = /** @type {HTMLElement} */ (document.getElementById("message"));
    message.textContent = "This browser is too old to show the page moving; here is a still picture.";
    message.hidden = false;
    document.body.dataset.ready = "no";
  }
})();
