// Draws the embedded objects, unlit and textured, turning in synchrony. WebGL 2, no library.
"use strict";
(() => {
  const TURN_PER_SECOND = 0.5;   // radians
  const FIELD_OF_VIEW = 0.6;     // radians, vertical
  const START = { azimuth: 0.9, elevation: 0.3, distance: 3.0 };
  const VERTEX_SHADER = `#version 300 es
    in vec3 position; in vec2 uv;
    uniform vec3 low, size; uniform mat4 toClip;
    out vec2 texel;
    void main() { texel = uv; gl_Position = toClip * vec4(low + size * position, 1.0); }`;
  const FRAGMENT_SHADER = `#version 300 es
    precision mediump float;
    in vec2 texel; uniform sampler2D colours; out vec4 colour;
    void main() { colour = vec4(texture(colours, texel).rgb, 1.0); }`;

  const objects = JSON.parse(document.getElementById("viewer-data").textContent);
  const canvases = [...document.querySelectorAll(".stage canvas")];
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const view = { ...START, turning: !still, changed: true };

  function bytes(text) {
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  }

  function program(gl) {
    const result = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX_SHADER],
                                  [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(result, shader);
    }
    gl.linkProgram(result);
    if (!gl.getProgramParameter(result, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(result));
    return result;
  }

  function attribute(gl, shaders, name, components, data) {
    const place = gl.getAttribLocation(shaders, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Uint16Array(data), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, components, gl.UNSIGNED_SHORT, true, 0, 0);
  }

  function texture(gl, image) {
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }

  // Uploads one object to the GPU; returns the handles for drawing.
  async function upload(canvas, object) {
    const gl = canvas.getContext("webgl2", { antialias: true });
    if (!gl) throw new Error("no WebGL 2");
    const image = new Image();
    image.src = object.texture;
    await image.decode();
    const shaders = program(gl);
    gl.useProgram(shaders);
    attribute(gl, shaders, "position", 3, bytes(object.positions));
    attribute(gl, shaders, "uv", 2, bytes(object.uvs));
    const indices = new Uint32Array(bytes(object.indices));
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    texture(gl, image);
    gl.uniform3fv(gl.getUniformLocation(shaders, "low"), object.low);
    gl.uniform3fv(gl.getUniformLocation(shaders, "size"), object.size);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.925, 0.933, 0.937, 1);
    return { canvas, gl, count: indices.length, toClip: gl.getUniformLocation(shaders, "toClip") };
  }

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  // Column-major world-to-clip matrix; the camera orbits the centre, +Z is up.
  function worldToClip(centre, radius, aspect) {
    const [ca, sa] = [Math.cos(view.azimuth), Math.sin(view.azimuth)];
    const [ce, se] = [Math.cos(view.elevation), Math.sin(view.elevation)];
    const right = [-sa, ca, 0], up = [-se * ca, -se * sa, ce], back = [ce * ca, ce * sa, se];
    const distance = view.distance * radius, focal = 1 / Math.tan(FIELD_OF_VIEW / 2);
    const near = Math.max(distance - 1.5 * radius, 0.05 * radius), far = distance + 1.5 * radius;
    const a = (far + near) / (near - far), b = 2 * far * near / (near - far);
    const rows = [[right, focal / aspect, 0], [up, focal, 0], [back, a, -distance * a + b],
                  [back, -1, distance]];
    const matrix = new Float32Array(16);
    rows.forEach(([axis, scale, shift], row) => {
      for (let k = 0; k < 3; ++k) matrix[4 * k + row] = scale * axis[k];
      matrix[12 + row] = shift - scale * dot(axis, centre);
    });
    return matrix;
  }

  function draw({ canvas, gl, count, toClip }, centre, radius) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * ratio);
    const height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(toClip, false, worldToClip(centre, radius, width / height));
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
  }

  // Fraction of a canvas that is not background. Tests use it to see that something was drawn.
  function coverage({ canvas, gl }) {
    const pixels = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    let covered = 0;
    for (let i = 0; i < pixels.length; i += 4) {
      covered += Math.abs(pixels[i] - 236) + Math.abs(pixels[i + 1] - 238) > 4 ? 1 : 0;
    }
    return covered * 4 / pixels.length;
  }

  // Marks the page after the first frame. With #measure in the address it adds the coverage and
  // stops the rotation, so that slow machines have time for the measurement.
  function announce(uploaded) {
    const mark = document.documentElement.dataset;
    if (location.hash === "#measure") {
      mark.coverage = uploaded.map((one) => coverage(one).toFixed(3)).join(" ");
      setTurning(false);
    }
    mark.viewer = "drawn";
  }

  function turn(azimuth, elevation) {
    view.azimuth += azimuth;
    view.elevation = Math.max(-1.5, Math.min(1.5, view.elevation + elevation));
    view.changed = true;
  }

  function zoom(factor) {
    view.distance = Math.max(1.3, Math.min(12, view.distance * factor));
    view.changed = true;
  }

  function setTurning(turning) {
    view.turning = turning;
    const button = document.getElementById("pause");
    button.textContent = turning ? "Pause" : "Turn";
    button.setAttribute("aria-pressed", String(!turning));
  }

  function listen(canvas) {
    const keys = { ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0),
                   ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
                   "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1.1) };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      setTurning(false);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) turn(-0.01 * event.movementX, 0.01 * event.movementY);
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(0.001 * event.deltaY));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  async function start() {
    const uploaded = await Promise.all(objects.map((object, i) => upload(canvases[i], object)));
    // All objects use the first one's bounding sphere, so that they stay comparable.
    const centre = objects[0].low.map((low, k) => low + objects[0].size[k] / 2);
    const radius = Math.hypot(...objects[0].size) / 2;
    canvases.forEach(listen);
    document.getElementById("pause").addEventListener("click", () => setTurning(!view.turning));
    document.getElementById("reset").addEventListener("click", () => Object.assign(view, START, { changed: true }));
    window.addEventListener("resize", () => { view.changed = true; });
    setTurning(view.turning);
    let before = null;
    function frame(now) {
      if (view.turning && before !== null) turn(TURN_PER_SECOND * Math.min(now - before, 100) / 1000, 0);
      if (view.changed) uploaded.forEach((one) => draw(one, centre, radius));
      if (before === null) announce(uploaded);
      view.changed = false;
      before = now;
      requestAnimationFrame(frame);
    }
    requestAnimationFrame(frame);
  }

  start().catch(() => {
    document.documentElement.dataset.viewer = "unavailable";
    document.getElementById("no-webgl").hidden = false;
    document.querySelector(".stage").hidden = true;
    document.querySelector(".controls").hidden = true;
  });
})();
