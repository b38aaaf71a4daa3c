// Turns the solid in the page: metal that is left, coloured by corrosion damage, one canvas an alloy.
//
// Three sets of triangles are drawn: the surface before immersion (triangles of the mesh, each pixel
// dropped where the damage there is at its limit), the surface to which the metal has receded (where
// the damage passes its limit inside a cell), and the section in the plane of the cut. The last two
// are cut out of the tetrahedra whenever the slider or the plane moves.
"use strict";
(() => {
  const place = document.getElementById("solid");
  if (!place) return;
  const about = JSON.parse(document.getElementById("solid-about").textContent);
  const PARTS = [[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3],
    [4, 5, 6, 8], [4, 7, 5, 8], [9, 5, 7, 8], [9, 6, 5, 8]];
  const EDGES = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
  const VALUES = 7; // of a corner: place, normal, damage

  // ------------------------------------------------------------------ the mesh

  async function unpack() {
    const text = document.getElementById("solid-data").textContent.trim();
    const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const buffer = await new Response(stream).arrayBuffer();
    let mesh = {
      points: new Float32Array(buffer, 0, 3 * about.points),
      cells: new Uint32Array(buffer, 12 * about.points, 4 * about.cells),
    };
    mesh.faces = outside(mesh);
    mesh.normals = normals(mesh);
    for (let n = 0; n < about.refined; n++) mesh = refine(mesh);
    const count = mesh.points.length / 3, first = 12 * about.points + 16 * about.cells;
    mesh.states = about.states.map((state, n) => (
      { ...state, damage: new Uint8Array(buffer, first + n * count, count) }));
    return mesh;
  }

  const edge = (points, a, b) => [0, 1, 2].map((i) => points[3 * b + i] - points[3 * a + i]);
  const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
  const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const unit = (u) => u.map((value) => value / (Math.hypot(...u) || 1));

  // corners of the faces that an odd number of cells has, turned outwards
  function outside({ points, cells }) {
    const found = new Map(), count = points.length / 3;
    for (let c = 0; c < cells.length; c += 4) {
      for (const [i, j, k, opposite] of [[1, 2, 3, 0], [0, 2, 3, 1], [0, 1, 3, 2], [0, 1, 2, 3]]) {
        const [p, q, r] = [cells[c + i], cells[c + j], cells[c + k]];
        const [a, b, d] = [p, q, r].sort((x, y) => x - y), key = (a * count + b) * count + d;
        if (found.delete(key)) continue;
        const across = cross(edge(points, p, q), edge(points, p, r));
        found.set(key, dot(across, edge(points, p, cells[c + opposite])) < 0 ? [p, q, r] : [p, r, q]);
      }
    }
    return Uint32Array.from([...found.values()].flat());
  }

  // of each corner: the mean of the faces around that meet this one at less than 35 degrees
  function normals({ points, faces }) {
    const flat = [], around = new Map(), sharp = Math.cos(35 * Math.PI / 180);
    for (let n = 0; n < faces.length; n += 3) {
      const [a, b, c] = faces.subarray(n, n + 3);
      for (const p of [a, b, c]) around.set(p, [...(around.get(p) || []), flat.length]);
      flat.push(cross(edge(points, a, b), edge(points, a, c)));
    }
    const units = flat.map(unit), found = new Float32Array(3 * faces.length);
    faces.forEach((p, n) => {
      const own = Math.floor(n / 3), sum = [0, 0, 0];
      for (const f of around.get(p))
        if (dot(units[own], units[f]) >= sharp) for (let i = 0; i < 3; i++) sum[i] += flat[f][i];
      found.set(unit(sum), 3 * n);
    });
    return found;
  }

  // every tetrahedron into eight at the middles of its edges; the middles in order of their ends
  function refine({ points, cells, faces, normals: old }) {
    const count = points.length / 3;
    const key = (a, b) => (a < b ? a * count + b : b * count + a);
    const keys = new Float64Array(6 * cells.length / 4);
    for (let c = 0, n = 0; c < cells.length; c += 4)
      for (const [a, b] of EDGES) keys[n++] = key(cells[c + a], cells[c + b]);
    keys.sort();
    const number = new Map();
    for (const k of keys) if (!number.has(k)) number.set(k, count + number.size);
    const finer = new Float32Array(3 * (count + number.size));
    finer.set(points);
    for (const [k, n] of number) {
      const a = Math.floor(k / count), b = k % count;
      for (let i = 0; i < 3; i++) finer[3 * n + i] = 0.5 * (points[3 * a + i] + points[3 * b + i]);
    }
    const more = new Uint32Array(8 * cells.length), corner = new Uint32Array(10);
    for (let c = 0, n = 0; c < cells.length; c += 4) {
      for (let k = 0; k < 4; k++) corner[k] = cells[c + k];
      EDGES.forEach(([a, b], k) => { corner[4 + k] = number.get(key(corner[a], corner[b])); });
      for (const part of PARTS) for (const k of part) more[n++] = corner[k];
    }
    const skin = new Uint32Array(4 * faces.length), smooth = new Float32Array(4 * old.length);
    for (let n = 0, used = 0; n < faces.length; n += 3) {
      const ends = [0, 1, 2].map((k) => [faces[n + k], old.subarray(3 * (n + k), 3 * (n + k + 1))]);
      const middles = [[0, 1], [1, 2], [2, 0]].map(([i, j]) => [
        number.get(key(ends[i][0], ends[j][0])), unit([0, 1, 2].map((k) => ends[i][1][k] + ends[j][1][k]))]);
      const [[a, b, c], [ab, bc, ca]] = [ends, middles];
      for (const [p, normal] of [a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca]) {
        skin[used] = p;
        smooth.set(normal, 3 * used++);
      }
    }
    return { points: finer, cells: more, faces: skin, normals: smooth };
  }

  // ------------------------------------------------------------------ what is cut out of the cells

  // triangles where `level` (n,) passes 0; each corner with the damage and, if given, the slope there
  function section({ points, cells }, level, damage, slope, normal) {
    let corners = new Float32Array(VALUES * 6144), used = 0;
    const above = [0, 0, 0, 0], below = [0, 0, 0, 0];
    const put = (a, b) => {
      const t = level[a] / (level[a] - level[b]);
      for (let i = 0; i < 3; i++) corners[used + i] = points[3 * a + i] + t * (points[3 * b + i] - points[3 * a + i]);
      for (let i = 0; i < 3; i++)
        corners[used + 3 + i] = slope ? slope[3 * a + i] + t * (slope[3 * b + i] - slope[3 * a + i]) : normal[i];
      corners[used + 6] = damage[a] + t * (damage[b] - damage[a]);
      used += VALUES;
    };
    for (let c = 0; c < cells.length; c += 4) {
      let up = 0, down = 0;
      for (let k = 0; k < 4; k++) {
        const p = cells[c + k];
        if (level[p] > 0) above[up++] = p; else below[down++] = p;
      }
      if (!up || !down) continue;
      if (used + 6 * VALUES > corners.length) {
        const longer = new Float32Array(2 * corners.length);
        longer.set(corners);
        corners = longer;
      }
      if (up === 1) for (let k = 0; k < 3; k++) put(above[0], below[k]);
      else if (down === 1) for (let k = 0; k < 3; k++) put(above[k], below[0]);
      else for (const [a, b] of [[0, 0], [0, 1], [1, 1], [0, 0], [1, 1], [1, 0]]) put(above[a], below[b]);
    }
    return corners.subarray(0, used);
  }

  // mean slope of the damage at the points, (3 n,), by which the receded surface is shaded
  function slopes({ points: x, cells }, damage) {
    const found = new Float32Array(x.length);
    for (let c = 0; c < cells.length; c += 4) {
      const o = cells[c], a = cells[c + 1], b = cells[c + 2], d = cells[c + 3];
      const fa = damage[a] - damage[o], fb = damage[b] - damage[o], fd = damage[d] - damage[o];
      if (!fa && !fb && !fd) continue;
      const ax = x[3 * a] - x[3 * o], ay = x[3 * a + 1] - x[3 * o + 1], az = x[3 * a + 2] - x[3 * o + 2];
      const bx = x[3 * b] - x[3 * o], by = x[3 * b + 1] - x[3 * o + 1], bz = x[3 * b + 2] - x[3 * o + 2];
      const dx = x[3 * d] - x[3 * o], dy = x[3 * d + 1] - x[3 * o + 1], dz = x[3 * d + 2] - x[3 * o + 2];
      const ux = by * dz - bz * dy, uy = bz * dx - bx * dz, uz = bx * dy - by * dx;
      const side = Math.sign(ax * ux + ay * uy + az * uz); // the length of the sum is the volume
      const gx = side * (fa * ux + fb * (dy * az - dz * ay) + fd * (ay * bz - az * by));
      const gy = side * (fa * uy + fb * (dz * ax - dx * az) + fd * (az * bx - ax * bz));
      const gz = side * (fa * uz + fb * (dx * ay - dy * ax) + fd * (ax * by - ay * bx));
      for (let k = 0; k < 4; k++) {
        const p = 3 * cells[c + k];
        found[p] += gx;
        found[p + 1] += gy;
        found[p + 2] += gz;
      }
    }
    return found;
  }

  // ------------------------------------------------------------------ drawing

  const VERTEX = `#version 300 es
    in vec3 place; in vec3 normal; in float damage;
    uniform mat3 turn; uniform vec3 scale; uniform vec3 centre;
    out vec3 at; out vec3 facing; out float f;
    void main() {
      at = place; facing = turn * normal; f = damage;
      vec3 seen = turn * (place - centre);
      gl_Position = vec4(seen * scale, 1.0);
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    in vec3 at; in vec3 facing; in float f;
    uniform vec3 ramp[6]; uniform float gone; uniform vec4 cut; uniform bool receded, probe, shell, plain;
    out vec4 colour;
    void main() {
      if (dot(cut.xyz, at) > cut.w + 1e-4) discard;
      if (shell) { colour = vec4(vec3(0.52, 0.58, 0.65) * 0.18, 0.18); return; }
      if (!receded && f > gone + 0.006) discard; // beyond the receded surface by a hair: no gaps
      if (probe) { colour = vec4(min(f, 1.0), 0.0, 1.0, 1.0); return; }
      float part = clamp(f / gone, 0.0, 1.0) * 5.0;
      int low = min(int(part), 4);
      vec3 paint = mix(ramp[low], ramp[low + 1], part - float(low));
      vec3 n = normalize(facing);
      float light = 0.4 + 0.52 * max(dot(n, vec3(-0.46, 0.53, 0.71)), 0.0)
        + 0.2 * max(dot(n, vec3(0.75, 0.1, 0.65)), 0.0) + 0.12 * max(n.y, 0.0);
      colour = vec4(plain ? paint : min(paint * light, 1.0), 1.0); // the section in the legend's colours
    }`;
  function colour(text) {
    return [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255);
  }

  class View {
    constructor(figure, mesh) {
      this.canvas = figure.querySelector("canvas");
      this.caption = figure.querySelector("figcaption span");
      this.mesh = mesh;
      this.corners = new Float32Array(VALUES * mesh.faces.length);
      mesh.faces.forEach((p, n) => {
        this.corners.set(mesh.points.subarray(3 * p, 3 * p + 3), VALUES * n);
        this.corners.set(mesh.normals.subarray(3 * n, 3 * n + 3), VALUES * n + 3);
      });
      const gl = this.canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
      if (!gl) throw new Error("This browser has no WebGL 2.");
      this.gl = gl;
      const program = gl.createProgram();
      for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, text);
        gl.compileShader(shader);
        gl.attachShader(program, shader);
      }
      ["place", "normal", "damage"].forEach((name, n) => gl.bindAttribLocation(program, n, name));
      gl.linkProgram(program);
      if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
      gl.useProgram(program);
      this.at = (name) => gl.getUniformLocation(program, name);
      gl.uniform3fv(this.at("ramp"), about.colours.flatMap(colour));
      gl.uniform1f(this.at("gone"), about.gone);
      gl.uniform3fv(this.at("centre"), camera.centre);
      gl.enable(gl.DEPTH_TEST);
      gl.enable(gl.CULL_FACE);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      this.sets = [0, 1, 2].map(() => {
        const array = gl.createVertexArray(), buffer = gl.createBuffer();
        gl.bindVertexArray(array);
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        [[3, 0], [3, 12], [1, 24]].forEach(([size, offset], n) => {
          gl.enableVertexAttribArray(n);
          gl.vertexAttribPointer(n, size, gl.FLOAT, false, 4 * VALUES, offset);
        });
        return { array, buffer, count: 0 };
      });
    }

    fill(n, corners) {
      const { gl } = this, set = this.sets[n];
      gl.bindBuffer(gl.ARRAY_BUFFER, set.buffer);
      gl.bufferData(gl.ARRAY_BUFFER, corners, gl.DYNAMIC_DRAW);
      set.count = corners.length / VALUES;
    }

    // damage (n,) at the points, 0 to 1
    corrode(damage) {
      this.damage = damage;
      this.mesh.faces.forEach((p, n) => { this.corners[VALUES * n + 6] = damage[p]; });
      this.fill(0, this.corners);
      const recedes = damage.some((f) => f > about.gone);
      const level = recedes ? damage.map((f) => f - about.gone) : null;
      this.fill(1, recedes ? section(this.mesh, level, damage, slopes(this.mesh, damage)) : new Float32Array(0));
    }

    // takes away what lies beyond the plane
    cutAt(normal, depth) {
      const { points } = this.mesh;
      this.gl.uniform4fv(this.at("cut"), normal ? [...normal, depth] : [0, 0, 0, 1]);
      if (!normal) return this.fill(2, new Float32Array(0));
      const level = Float32Array.from({ length: points.length / 3 }, (_, p) =>
        normal[0] * points[3 * p] + normal[1] * points[3 * p + 1] + normal[2] * points[3 * p + 2] - depth);
      return this.fill(2, section(this.mesh, level, this.damage, null, normal));
    }

    draw(spot = null) {
      const { gl, canvas } = this, dense = Math.min(window.devicePixelRatio || 1, 2);
      const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.max(1, Math.round(v * dense)));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      gl.viewport(0, 0, width, height);
      if (spot) {
        gl.enable(gl.SCISSOR_TEST);
        gl.scissor(...spot, 1, 1);
      } else gl.disable(gl.SCISSOR_TEST);
      gl.disable(gl.BLEND);
      gl.depthMask(true);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      const scale = camera.zoom * Math.min(height / camera.tall, width / camera.wide); // pixels a mm
      gl.uniformMatrix3fv(this.at("turn"), false, camera.matrix());
      gl.uniform3f(this.at("scale"), 2 * scale / width, 2 * scale / height, -1 / camera.deep);
      gl.uniform1i(this.at("probe"), spot ? 1 : 0);
      gl.uniform1i(this.at("shell"), 0);
      this.sets.forEach((set, n) => this.triangles(set, n ? null : gl.BACK, n));
      if (spot) return;
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.uniform1i(this.at("shell"), 1);
      this.triangles(this.sets[0], gl.FRONT, 0);
    }

    // number: 0 surface, 1 receded surface, 2 section
    triangles(set, hidden, number) {
      const { gl } = this;
      if (!set.count) return;
      if (hidden) gl.enable(gl.CULL_FACE);
      else gl.disable(gl.CULL_FACE);
      if (hidden) gl.cullFace(hidden);
      gl.uniform1i(this.at("receded"), number === 1 ? 1 : 0);
      gl.uniform1i(this.at("plain"), number === 2 ? 1 : 0);
      gl.bindVertexArray(set.array);
      gl.drawArrays(gl.TRIANGLES, 0, set.count);
    }

    // damage under the pointer, or null beside the metal
    damageAt(event) {
      const { gl, canvas } = this, box = canvas.getBoundingClientRect(), found = new Uint8Array(4);
      const x = Math.floor((event.clientX - box.left) * canvas.width / box.width);
      const y = Math.floor((box.bottom - event.clientY) * canvas.height / box.height);
      this.draw([x, y]);
      gl.readPixels(x, y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, found);
      this.draw();
      return found[2] === 255 && found[3] === 255 ? found[0] / 255 : null;
    }
  }

  // ------------------------------------------------------------------ what the reader does

  const camera = {
    azimuth: 35, elevation: 22, zoom: 1, centre: [0, 0, 0], tall: 1, wide: 1, deep: 1,
    fit(points) {
      const low = [0, 1, 2].map((i) => points.reduce((m, v, n) => (n % 3 === i ? Math.min(m, v) : m), Infinity));
      const high = [0, 1, 2].map((i) => points.reduce((m, v, n) => (n % 3 === i ? Math.max(m, v) : m), -Infinity));
      this.low = low;
      this.high = high;
      this.centre = low.map((value, i) => 0.5 * (value + high[i]));
      const extent = low.map((value, i) => high[i] - value);
      this.deep = Math.hypot(...extent);
      this.tall = 1.02 * (extent[2] * Math.cos(0.38) + Math.hypot(extent[0], extent[1]) * Math.sin(0.38));
      this.wide = 1.02 * Math.hypot(extent[0], extent[1]);
    },
    direction() {
      const [turn, rise] = [this.azimuth, this.elevation].map((angle) => angle * Math.PI / 180);
      return [Math.cos(rise) * Math.cos(turn), Math.cos(rise) * Math.sin(turn), Math.sin(rise)];
    },
    matrix() {
      const d = this.direction(), turn = this.azimuth * Math.PI / 180;
      const right = [-Math.sin(turn), Math.cos(turn), 0], up = cross(d, right);
      return [0, 1, 2].flatMap((i) => [right[i], up[i], d[i]]);
    },
    turn(right, up) {
      this.azimuth -= right;
      this.elevation = Math.max(-90, Math.min(90, this.elevation + up));
    },
    nearer(factor) { this.zoom = Math.max(0.5, Math.min(8, this.zoom * factor)); },
  };

  function inWords(seconds) {
    for (const [name, unit] of [["week", 604800], ["day", 86400], ["hour", 3600]]) {
      const count = seconds / unit;
      if (Math.abs(count - Math.round(count)) < 1e-6 || (count >= 2 && name !== "hour"))
        return `${+count.toPrecision(3)} ${name}${count === 1 ? "" : "s"}`;
    }
    return `${+seconds.toPrecision(3)} seconds`;
  }

  function start(mesh) {
    const field = (name) => place.querySelector(`[name=${name}]`);
    const times = [...new Set(mesh.states.map((state) => state.seconds))].sort((a, b) => a - b);
    camera.fit(mesh.points);
    const views = [...place.querySelectorAll("figure")].map((figure) => new View(figure, mesh));
    let waiting = false;
    const redraw = () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => { waiting = false; views.forEach((view) => view.draw()); });
    };

    function showTime() {
      const at = Number(field("time").value), low = Math.floor(at), part = at - low;
      const [t0, t1] = [times[low], times[Math.min(low + 1, times.length - 1)]];
      const now = t0 + part * (t1 - t0);
      place.querySelector("[for=solid-time] output").textContent =
        part ? `${inWords(now)}, between computed times` : inWords(now);
      views.forEach((view, n) => {
        const known = mesh.states.filter((state) => state.alloy === n);
        const before = known.filter((state) => state.seconds <= now).pop() || known[0];
        const after = known.find((state) => state.seconds >= now) || known[known.length - 1];
        const share = after.seconds > before.seconds ? (now - before.seconds) / (after.seconds - before.seconds) : 0;
        view.corrode(Float32Array.from(before.damage, (f, p) => (f + share * (after.damage[p] - f)) / about.most));
        view.caption.textContent = share ? "" : before.caption;
      });
      showCut();
    }

    function showCut() {
      const turn = 35 * Math.PI / 180, part = Number(field("depth").value);
      const normal = { none: null, front: [Math.cos(turn), Math.sin(turn), 0],
        side: [Math.sin(turn), -Math.cos(turn), 0], across: [0, 0, 1] }[field("cut").value];
      field("depth").disabled = !normal;
      const half = normal ? 0.5 * camera.high.reduce((sum, v, i) => sum + Math.abs(normal[i]) * (v - camera.low[i]), 0) : 0;
      const middle = normal ? dot(normal, camera.centre) : 0;
      views.forEach((view) => view.cutAt(normal, middle + part * half));
      redraw();
    }

    field("time").max = times.length - 1;
    field("time").value = times.length - 1;
    field("time").step = times.length > 1 ? 0.1 : 1;
    place.querySelector(".stops").replaceChildren(...times.map((time) => {
      const stop = document.createElement("span");
      stop.textContent = inWords(time);
      return stop;
    }));
    field("time").addEventListener("input", showTime);
    field("cut").addEventListener("input", showCut);
    field("depth").addEventListener("input", showCut);
    views.forEach((view) => listen(view, redraw));
    new ResizeObserver(redraw).observe(place);
    place.classList.add("ready");
    showTime();
  }

  function listen(view, redraw) {
    const { canvas } = view, held = new Map();
    const tip = (text, event) => canvas.dispatchEvent(new CustomEvent("tip", {
      bubbles: true, detail: { text, x: event.clientX, y: event.clientY } }));
    canvas.style.aspectRatio = `${Math.max(0.5, Math.min(1.6, camera.wide / camera.tall))}`;
    canvas.addEventListener("pointerdown", (event) => {
      held.set(event.pointerId, event);
      canvas.setPointerCapture(event.pointerId);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
      canvas.addEventListener(name, (event) => held.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const last = held.get(event.pointerId);
      if (!last) {
        const damage = view.damageAt(event);
        const left = damage === null ? 0 : Math.max(0, 100 * (1 - damage / about.gone)).toFixed(0);
        return tip(damage === null ? "" : `damage ${damage.toFixed(2)}: ${left} % of the strength left here`, event);
      }
      const others = [...held.values()].filter((other) => other.pointerId !== event.pointerId);
      const apart = (one) => Math.hypot(one.clientX - others[0].clientX, one.clientY - others[0].clientY);
      if (others.length) camera.nearer(apart(event) / (apart(last) || 1));
      else camera.turn(0.5 * (event.clientX - last.clientX), 0.5 * (event.clientY - last.clientY));
      held.set(event.pointerId, event);
      tip("", event);
      return redraw();
    });
    canvas.addEventListener("pointerleave", (event) => tip("", event));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // the page scrolls
      event.preventDefault();
      camera.nearer(Math.exp(-0.005 * event.deltaY));
      redraw();
    }, { passive: false });
    canvas.addEventListener("dblclick", () => {
      Object.assign(camera, { azimuth: 35, elevation: 22, zoom: 1 });
      redraw();
    });
    canvas.addEventListener("keydown", (event) => {
      const turned = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, -5], ArrowDown: [0, 5] }[event.key];
      if (turned) camera.turn(...turned);
      else if (event.key === "+" || event.key === "-") camera.nearer(event.key === "+" ? 1.1 : 1 / 1.1);
      else return;
      event.preventDefault();
      redraw();
    });
  }

  unpack().then(start).catch((error) => {
    place.classList.add("failed");
    place.querySelector(".trouble").textContent =
      `The solid cannot be turned here: ${error.message} The pictures below show the same.`;
  });
})();
