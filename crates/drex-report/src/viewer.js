// Draws the scenes of the report. Each figure of the class "view" holds a still picture, which stays where there is no WebGL 2, and a
// scene as JSON with typed arrays in base64 (viewer.rs writes it). One WebGL context draws all of them, one after the other,
// because browsers allow only a few; each scene has a plain canvas that the picture is copied to. World: metres, z up.
"use strict";
(() => {
  const figures = [...document.querySelectorAll("figure.view")];
  const shared = document.createElement("canvas");
  const gl = figures.length ? shared.getContext("webgl2", { antialias: true }) : null;
  if (!gl) return;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;

  // ---- arrays and small matrices (column by column)
  const bytes = (text) => {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const unit = (a) => { const l = Math.hypot(...a) || 1; return a.map((v) => v / l); };
  const product = (a, b) => {
    const out = new Float32Array(16);
    for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++)
      for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    return out;
  };
  const rotation = (w, x, y, z) => [
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)];

  // ---- programs
  const compile = (vertex, fragment) => {
    const program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;precision highp int;precision highp sampler2D;" + text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "p");
    gl.bindAttribLocation(program, 1, "n");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      if (gl.isContextLost()) return null;
      throw new Error("viewer: " + gl.getProgramInfoLog(program));
    }
    const at = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      at[name] = gl.getUniformLocation(program, name);
    }
    return { program, at };
  };
  const solid = compile(
    `in vec3 p,n;uniform mat4 look,model;out vec3 at,normal;
     void main(){vec4 w=model*vec4(p,1.);at=w.xyz;normal=mat3(model)*n;gl_Position=look*w;}`,
    `in vec3 at,normal;uniform vec3 eye,right,color;out vec4 o;
     void main(){vec3 e=normalize(eye-at),n=normalize(normal);if(dot(n,e)<0.)n=-n;
      float key=max(0.,dot(n,normalize(e-.6*right+vec3(0,0,.9)))),fill=max(0.,dot(n,normalize(e+1.2*right)));
      o=vec4(min(color*(.34+.6*key+.16*fill),1.),1.);}`);
  // A picture as it is: the light of the photos is in it.
  const printed = compile(
    "in vec3 p,n;uniform mat4 look,model;out vec2 uv;void main(){uv=n.xy;gl_Position=look*model*vec4(p,1.);}",
    "in vec2 uv;uniform sampler2D picture;out vec4 o;void main(){o=vec4(texture(picture,uv).rgb,1.);}");
  const wire = compile(
    "in vec3 p;uniform mat4 look,model;void main(){gl_Position=look*model*vec4(p,1.);gl_Position.z-=.002*gl_Position.w;}",
    "uniform vec4 color;out vec4 o;void main(){o=vec4(color.rgb*color.a,color.a);}");
  const table = compile(
    `in vec3 p;uniform mat4 look;uniform vec4 disc;out vec2 at;
     void main(){at=disc.xy+p.xy*disc.w;gl_Position=look*vec4(at,disc.z,1.);}`,
    `in vec2 at;uniform vec4 disc;uniform float square;uniform vec3 ink;out vec4 o;
     void main(){float d=length(at-disc.xy)/disc.w,fade=1.-d*d;if(fade<=0.)discard;vec2 c=floor(at/square);
      float a=fade*(mod(c.x+c.y,2.)<.5?.17:.09);o=vec4(ink*a,a);}`);
  // A Gaussian on the screen: covariance J W S Wt Jt of the projection, an ellipse of three standard deviations.
  const splat = compile(
    `in vec3 p;in uint n;uniform sampler2D data;uniform mat4 look,view;uniform vec2 size;uniform float focal;
     out vec2 q;out vec4 color;
     vec4 row(int k){int i=int(n)*4+k;return texelFetch(data,ivec2(i%2048,i/2048),0);}
     void main(){vec4 a=row(0),b=row(1),c=row(2);vec3 v=(view*vec4(a.xyz,1.)).xyz;float d=-v.z;
      if(d<1e-4){gl_Position=vec4(0,0,2,1);return;}
      mat3 s=mat3(b.x,b.y,b.z,b.y,b.w,c.x,b.z,c.x,c.y),w=mat3(view);s=w*s*transpose(w);
      vec3 j=vec3(focal/d,0.,focal*v.x/(d*d)),k=vec3(0.,focal/d,focal*v.y/(d*d));
      float xx=dot(j,s*j)+.3,xy=dot(j,s*k),yy=dot(k,s*k)+.3,m=.5*(xx+yy),r=length(vec2(.5*(xx-yy),xy));
      float l=m+r,t=max(m-r,.1);vec2 e=abs(xy)>1e-6?normalize(vec2(xy,l-xx)):(xx>=yy?vec2(1,0):vec2(0,1));
      q=3.*p.xy;vec2 o=q.x*min(sqrt(l),.25*size.y)*e+q.y*min(sqrt(t),.25*size.y)*vec2(-e.y,e.x);
      gl_Position=look*vec4(a.xyz,1.);gl_Position.xy+=2.*o/size*gl_Position.w;color=vec4(row(3).rgb,a.w);}`,
    `in vec2 q;in vec4 color;out vec4 o;
     void main(){float r=dot(q,q);if(r>9.)discard;float a=color.a*exp(-.5*r);o=vec4(color.rgb*a,a);}`);
  if (!solid || !printed || !wire || !table || !splat) return;
  const buffer = (data, target = gl.ARRAY_BUFFER) => {
    const b = gl.createBuffer();
    gl.bindBuffer(target, b);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return b;
  };
  const square = buffer(new Float32Array([-1, -1, 0, 1, -1, 0, -1, 1, 0, 1, 1, 0]));

  // ---- a mesh: corners with normals that are shared where faces meet at less than 40 degrees, and its edges as lines
  const readMesh = (m) => {
    const raw = new Uint16Array(bytes(m.v)), count = raw.length / 3;
    const v = Array.from({ length: count }, (_, i) => [0, 1, 2].map((k) => m.lo[k] + m.step[k] * raw[3 * i + k]));
    const f = m.wide ? new Uint32Array(bytes(m.f)) : new Uint16Array(bytes(m.f));
    const faces = f.length / 3, around = Array.from({ length: count }, () => []), big = [], normals = [];
    for (let i = 0; i < faces; i++) {
      const [a, b, c] = [0, 1, 2].map((k) => v[f[3 * i + k]]);
      big.push(cross(minus(b, a), minus(c, a)));
      normals.push(unit(big[i]));
      for (let k = 0; k < 3; k++) around[f[3 * i + k]].push(i);
    }
    const at = new Float32Array(9 * faces), n = new Float32Array(9 * faces), edges = new Map();
    for (let i = 0; i < faces; i++) for (let k = 0; k < 3; k++) {
      const a = f[3 * i + k], b = f[3 * i + (k + 1) % 3], sum = [0, 0, 0];
      for (const j of around[a]) if (dot(normals[i], normals[j]) > 0.77) for (let c = 0; c < 3; c++) sum[c] += big[j][c];
      at.set(v[a], 9 * i + 3 * k);
      n.set(unit(sum), 9 * i + 3 * k);
      const key = Math.min(a, b) * count + Math.max(a, b);
      edges.set(key, [...(edges.get(key) || []), i]);
    }
    const lines = [];
    for (const [key, sides] of edges) {
      // Edges inside flat faces say nothing.
      if (sides.length === 2 && dot(normals[sides[0]], normals[sides[1]]) > 0.9975) continue;
      lines.push(...v[Math.floor(key / count)], ...v[key % count]);
    }
    // Where the picture of a mesh is, texture coordinates take the place of normals.
    const looks = m.looks && readPicture(m.looks.picture);
    if (looks) {
      const uv = new Uint16Array(bytes(m.looks.uv));
      for (let i = 0; i < 3 * faces; i++) n.set([uv[2 * f[i]] / 65535, uv[2 * f[i] + 1] / 65535, 0], 3 * i);
    }
    return { p: buffer(at), n: buffer(n), looks, corners: 3 * faces, lines: buffer(new Float32Array(lines)), ends: lines.length / 3 };
  };

  // A texture that is grey until the browser has decoded its picture.
  const readPicture = (source) => {
    const texture = gl.createTexture(), picture = new Image();
    const fill = (...pixels) => {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, ...pixels, gl.RGBA, gl.UNSIGNED_BYTE, pixels.length ? new Uint8Array([150, 150, 150, 255]) : picture);
    };
    fill(1, 1, 0);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    picture.onload = () => {
      fill();
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      views.forEach((v) => v.touch());
    };
    picture.src = source;
    return texture;
  };

  const readSplats = (s) => {
    const p = new Uint16Array(bytes(s.p)), sd = new Uint8Array(bytes(s.s)), q = new Int8Array(bytes(s.q));
    const c = new Uint8Array(bytes(s.c)), rows = Math.max(1, Math.ceil(s.n / 512));
    const data = new Float32Array(rows * 2048 * 4), at = new Float32Array(3 * s.n);
    for (let i = 0; i < s.n; i++) {
      const o = 16 * i, t = unit([0, 1, 2, 3].map((k) => q[4 * i + k])), r = rotation(...t);
      const size = [0, 1, 2].map((k) => Math.exp(2 * (s.size_lo + s.size_step * sd[3 * i + k])));
      const cov = (a, b) => size[0] * r[a] * r[b] + size[1] * r[3 + a] * r[3 + b] + size[2] * r[6 + a] * r[6 + b];
      for (let k = 0; k < 3; k++) data[o + k] = at[3 * i + k] = s.lo[k] + s.step[k] * p[3 * i + k];
      data[o + 3] = c[4 * i + 3] / 255;
      data.set([cov(0, 0), cov(0, 1), cov(0, 2), cov(1, 1), cov(1, 2), cov(2, 2)], o + 4);
      data.set([c[4 * i] / 255, c[4 * i + 1] / 255, c[4 * i + 2] / 255], o + 12);
    }
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 2048, rows, 0, gl.RGBA, gl.FLOAT, data);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    return { n: s.n, at, texture, order: gl.createBuffer() };
  };

  // Far ones first: counting sort of the depths in 4096 steps.
  const sorted = (s, forward) => {
    const depth = new Float32Array(s.n), counts = new Uint32Array(4097), order = new Uint32Array(s.n);
    let lo = Infinity, hi = -Infinity;
    for (let i = 0; i < s.n; i++) {
      depth[i] = forward[0] * s.at[3 * i] + forward[1] * s.at[3 * i + 1] + forward[2] * s.at[3 * i + 2];
      lo = Math.min(lo, depth[i]);
      hi = Math.max(hi, depth[i]);
    }
    const bin = (i) => Math.floor((hi - depth[i]) / (hi - lo || 1) * 4095);
    for (let i = 0; i < s.n; i++) counts[bin(i) + 1]++;
    for (let i = 0; i < 4096; i++) counts[i + 1] += counts[i];
    for (let i = 0; i < s.n; i++) order[counts[bin(i)]++] = i;
    return order;
  };

  // A pose is x, y, z, then w, x, y, z of the quaternion, then a scale; straight between two frames.
  const modelAt = (part, place) => {
    const last = part.poses.length / 8 - 1, at = Math.min(place, last), i = Math.floor(at), s = at - i;
    const a = part.poses.subarray(8 * i, 8 * i + 8), b = part.poses.subarray(8 * Math.min(i + 1, last));
    const same = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] < 0 ? -1 : 1;
    const mix = (k, sign) => a[k] + (sign * b[k] - a[k]) * s;
    const r = rotation(...unit([3, 4, 5, 6].map((k) => mix(k, same)))).map((v) => v * mix(7, 1));
    return new Float32Array([...r.slice(0, 3), 0, ...r.slice(3, 6), 0, ...r.slice(6, 9), 0, mix(0, 1), mix(1, 1), mix(2, 1), 1]);
  };

  // ---- one scene in its figure
  const add = (tag, parent, attributes = {}) => {
    const e = parent.appendChild(document.createElement(tag));
    for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v);
    return e;
  };
  const views = [];
  let waiting = false, before = 0;
  const wake = () => {
    if (!waiting) { waiting = true; requestAnimationFrame(step); }
  };
  const step = (now) => {
    waiting = false;
    const dt = Math.min(0.1, (now - before) / 1000);
    before = now;
    let more = false;
    for (const v of views) if (v.seen) {
      more = v.advance(dt) || more;
      if (v.dirty) v.draw();
    }
    if (more) wake();
  };

  class View {
    constructor(figure) {
      const d = this.scene = JSON.parse(figure.querySelector("script").textContent);
      this.figure = figure;
      this.home = { azimuth: d.azimuth, elevation: d.elevation, zoom: 1 };
      Object.assign(this, this.home);
      this.turning = !still;
      this.playing = false;
      this.seen = this.dirty = false;
      const stage = figure.querySelector(".stage");
      this.canvas = add("canvas", stage, { tabindex: "0", role: "img", "aria-label": figure.dataset.label +
        ": drag or use the arrow keys to turn, plus and minus to zoom, 0 to go back" });
      this.ink = this.canvas.getContext("2d");
      this.times = d.times ? new Float32Array(bytes(d.times)) : null;
      if (this.times) this.controls(figure);
      this.listen();
      figure.classList.add("live");
    }

    load() {
      const d = this.scene;
      this.meshes = d.meshes.map(readMesh);
      this.parts = d.parts.map((p) => ({ ...p, mesh: this.meshes[p.mesh], poses: new Float32Array(bytes(p.poses)) }));
      this.splats = d.splats && readSplats(d.splats);
    }

    controls(figure) {
      const [first, last] = [this.times[0], this.times[this.times.length - 1]];
      const bar = add("div", figure, { class: "bar" });
      figure.insertBefore(bar, figure.querySelector("figcaption"));
      this.button = add("button", bar, { type: "button" });
      this.slider = add("input", bar, { type: "range", min: first, max: last, step: (last - first) / 1000, "aria-label": "time, s" });
      this.clock = add("output", bar);
      this.button.onclick = () => this.play(!this.playing);
      this.slider.oninput = () => { this.play(false); this.show(+this.slider.value); };
      this.cursors = [...document.querySelectorAll(`[data-follows="${figure.id}"] svg[data-range]`)].map((svg) => {
        const line = document.createElementNS(svg.namespaceURI, "line");
        for (const [k, v] of [["stroke", "currentColor"], ["stroke-width", 1.5], ["opacity", 0.75]]) line.setAttribute(k, v);
        svg.appendChild(line);
        return { line, range: svg.dataset.range.split(" ").map(Number) };
      });
      this.play(false);
      this.show(this.scene.start ?? first);
    }

    play(on) {
      const first = this.times[0], last = this.times[this.times.length - 1];
      // The slider's steps may end a little before the last frame.
      if (on && this.time > last - 0.002 * (last - first)) this.show(first);
      this.playing = on;
      this.button.textContent = on ? "Pause" : "Play";
      wake();
    }

    show(time) {
      this.time = time;
      this.slider.value = time;
      const phase = this.scene.phases.filter((p) => p[0] <= time + 1e-6).pop();
      this.clock.textContent = `${time.toFixed(2)} s` + (phase ? `, ${phase[1]}` : "");
      for (const { line, range: [x0, x1, left, right, top, bottom] } of this.cursors) {
        const x = left + (Math.min(Math.max(time, x0), x1) - x0) / (x1 - x0) * (right - left);
        for (const [k, v] of [["x1", x], ["x2", x], ["y1", top], ["y2", bottom]]) line.setAttribute(k, v);
      }
      this.touch();
    }

    /// Where in the frames the time is: 2.5 is half way between the third and the fourth.
    place(time = this.time) {
      if (!this.times) return 0;
      let i = 0;
      while (i < this.times.length - 2 && this.times[i + 1] <= time) i++;
      const span = this.times[i + 1] - this.times[i];
      return this.times.length < 2 ? 0 : i + Math.min(1, Math.max(0, (time - this.times[i]) / (span || 1)));
    }

    touch() {
      this.dirty = true;
      if (this.seen) wake();
    }

    turn(azimuth, elevation, zoom = 1) {
      this.turning = false;
      this.azimuth += azimuth;
      this.elevation = Math.min(1.5, Math.max(-0.6, this.elevation + elevation));
      this.zoom = Math.min(8, Math.max(0.4, this.zoom * zoom));
      this.share();
    }

    /// Scenes that show the same thing are turned together.
    share() {
      const { azimuth, elevation, zoom, turning } = this;
      for (const v of views) if (v === this || (this.scene.link && v.scene.link === this.scene.link)) {
        Object.assign(v, { azimuth, elevation, zoom, turning });
        v.touch();
      }
    }

    listen() {
      const c = this.canvas, held = new Map();
      const spread = () => { const [a, b] = [...held.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
      c.onpointerdown = (e) => { held.set(e.pointerId, { x: e.clientX, y: e.clientY }); c.setPointerCapture(e.pointerId); };
      c.onpointerup = c.onpointercancel = (e) => held.delete(e.pointerId);
      c.onpointermove = (e) => {
        const from = held.get(e.pointerId);
        if (!from) return;
        const apart = held.size === 2 ? spread() : 0;
        held.set(e.pointerId, { x: e.clientX, y: e.clientY });
        if (held.size === 2) this.turn(0, 0, spread() / (apart || 1));
        else if (held.size === 1) this.turn((from.x - e.clientX) * 0.009, (e.clientY - from.y) * 0.009);
      };
      // A wheel scrolls the page until the scene has been clicked.
      c.addEventListener("wheel", (e) => {
        if (document.activeElement !== c && !e.ctrlKey) return;
        e.preventDefault();
        this.turn(0, 0, Math.exp(-e.deltaY * 0.0015));
      }, { passive: false });
      c.onkeydown = (e) => {
        const turns = { ArrowLeft: [0.12, 0], ArrowRight: [-0.12, 0], ArrowUp: [0, 0.12], ArrowDown: [0, -0.12],
          "+": [0, 0, 1.15], "=": [0, 0, 1.15], "-": [0, 0, 1 / 1.15] };
        if (turns[e.key]) this.turn(...turns[e.key]);
        else if (e.key === "0") { Object.assign(this, this.home, { turning: false }); this.share(); }
        else if (e.key === " " && this.times) this.play(!this.playing);
        else return;
        e.preventDefault();
      };
      new ResizeObserver(() => this.touch()).observe(c);
      new IntersectionObserver(([e]) => {
        this.seen = e.isIntersecting;
        if (this.seen) { this.dirty = true; wake(); }
      }, { rootMargin: "100px" }).observe(c);
    }

    /// What goes on by itself; whether there is more of it.
    advance(dt) {
      if (this.playing) {
        const last = this.times[this.times.length - 1];
        this.show(Math.min(this.time + dt, last));
        if (this.time >= last) this.play(false);
      }
      if (this.turning) {
        this.azimuth += 0.25 * dt;
        this.dirty = true;
      }
      return this.turning || this.playing;
    }

    draw() {
      const ratio = Math.min(2, devicePixelRatio || 1), box = this.canvas.getBoundingClientRect();
      const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
      if (!width || !height) return;
      if (!this.parts) this.load();
      this.dirty = false;
      if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
      // The shared canvas only grows: resizing it for each scene costs more than drawing.
      if (shared.width < width) shared.width = width;
      if (shared.height < height) shared.height = height;
      gl.viewport(0, 0, width, height);
      gl.disable(gl.SCISSOR_TEST);
      gl.depthMask(true);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      this.render(width, height);
      this.ink.clearRect(0, 0, width, height);
      this.ink.drawImage(shared, 0, shared.height - height, width, height, 0, 0, width, height);
    }

    render(width, height) {
      const { radius, follow } = this.scene, far = 4.2 * radius / this.zoom, place = this.place(), centre = [...this.scene.centre];
      if (follow !== null) centre[2] += modelAt(this.parts[follow], place)[14] - modelAt(this.parts[follow], this.place(this.scene.start))[14];
      const [sa, ca, se, ce] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.elevation), Math.cos(this.elevation)];
      const back = [ce * ca, ce * sa, se], right = [-sa, ca, 0], up = cross(back, right);
      const eye = centre.map((c, k) => c + far * back[k]);
      const focal = 0.92 * 0.5 * Math.min(width, height) * Math.sqrt(4.2 * 4.2 - 1), near = Math.max(0.02, far / radius - 3.2) * radius;
      const end = far + 4 * radius;
      const view = new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
        -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
      const look = product(new Float32Array([2 * focal / width, 0, 0, 0, 0, 2 * focal / height, 0, 0,
        0, 0, -(end + near) / (end - near), -1, 0, 0, -2 * end * near / (end - near), 0]), view);
      const use = ({ program, at }) => { gl.useProgram(program); gl.uniformMatrix4fv(at.look, false, look); return at; };
      const feed = (slot, b) => { gl.enableVertexAttribArray(slot); gl.bindBuffer(gl.ARRAY_BUFFER, b);
        gl.vertexAttribPointer(slot, 3, gl.FLOAT, false, 0, 0); };
      gl.enable(gl.DEPTH_TEST);
      gl.disable(gl.BLEND);
      gl.vertexAttribDivisor(1, 0);
      let at = use(solid);
      gl.uniform3fv(at.eye, eye);
      gl.uniform3fv(at.right, right);
      const faces = (part) => {
        gl.uniformMatrix4fv(at.model, false, modelAt(part, place));
        feed(0, part.mesh.p);
        feed(1, part.mesh.n);
        gl.drawArrays(gl.TRIANGLES, 0, part.mesh.corners);
      };
      const solids = this.parts.filter((p) => p.look === "solid");
      for (const part of solids.filter((p) => !p.mesh.looks)) {
        gl.uniform3fv(at.color, part.color);
        faces(part);
      }
      at = use(printed);
      gl.activeTexture(gl.TEXTURE0);
      for (const part of solids.filter((p) => p.mesh.looks)) {
        gl.bindTexture(gl.TEXTURE_2D, part.mesh.looks);
        faces(part);
      }
      gl.disableVertexAttribArray(1);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      gl.depthMask(false);
      if (this.scene.table !== null) {
        at = use(table);
        gl.uniform4f(at.disc, centre[0], centre[1], this.scene.table, 2.2 * radius);
        const tenth = 10 ** Math.floor(Math.log10(radius / 4));
        gl.uniform1f(at.square, [5, 2, 1].map((k) => k * tenth).find((l) => l <= radius / 4) || tenth);
        gl.uniform3fv(at.ink, getComputedStyle(this.canvas).color.match(/[\d.]+/g).slice(0, 3).map((v) => v / 255));
        feed(0, square);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      }
      if (this.splats) this.renderSplats(use(splat), feed, { view, size: [width, height], focal, back });
      at = use(wire);
      for (const part of this.parts.filter((p) => p.look === "wire")) {
        gl.uniformMatrix4fv(at.model, false, modelAt(part, place));
        feed(0, part.mesh.lines);
        // What is hidden shines through.
        for (const [hidden, alpha] of [[true, 0.25], [false, 0.9]]) {
          (hidden ? gl.disable : gl.enable).call(gl, gl.DEPTH_TEST);
          gl.uniform4f(at.color, ...part.color, alpha);
          gl.drawArrays(gl.LINES, 0, part.mesh.ends);
        }
      }
    }

    renderSplats(at, feed, { view, size, focal, back }) {
      const s = this.splats;
      gl.uniformMatrix4fv(at.view, false, view);
      gl.uniform2fv(at.size, size);
      gl.uniform1f(at.focal, focal);
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, s.texture);
      feed(0, square);
      gl.bindBuffer(gl.ARRAY_BUFFER, s.order);
      gl.bufferData(gl.ARRAY_BUFFER, sorted(s, back.map((v) => -v)), gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribIPointer(1, 1, gl.UNSIGNED_INT, 0, 0);
      gl.vertexAttribDivisor(1, 1);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, s.n);
      gl.vertexAttribDivisor(1, 0);
      gl.disableVertexAttribArray(1);
    }
  }

  for (const figure of figures) views.push(new View(figure));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => views.forEach((v) => v.touch()));
  // Without its context the pictures come back.
  shared.addEventListener("webglcontextlost", () => figures.forEach((f) => f.classList.remove("live")));
})();
