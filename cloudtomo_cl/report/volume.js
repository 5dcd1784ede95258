// The volumes in 3-D, by WebGL 2: rays through a texture. Without it the flat picture stays.
const shaders = [`#version 300 es
in vec2 corner; out vec2 place;
void main() { place = corner; gl_Position = vec4(corner, 0., 1.); }`, `#version 300 es
precision highp float; precision highp sampler3D;
uniform sampler3D volume; uniform sampler2D palette;
uniform vec3 right, up, towards, extent; uniform vec2 middle; uniform float half_width, largest, shown, stride; uniform int colouring;
in vec2 place; out vec4 colour;
void main() {
  vec2 aside = middle + half_width * place;
  vec3 start = .5 * extent + aside.x * right + aside.y * up;
  vec3 one = (vec3(0.) - start) / -towards, other = (extent - start) / -towards;
  vec3 first = min(one, other), last = max(one, other);
  float near = max(max(first.x, first.y), first.z), far = min(min(last.x, last.y), last.z);
  float light = 0., clear = 1., most = 0.;
  if (near < far) for (int n = 0; n < 700; n++) {
    float along = near + (float(n) + .5) * stride;
    if (along > far || clear < .003) break;
    vec2 voxel = texture(volume, (start - along * towards) / extent).rg;
    float extinction = voxel.r * voxel.r * largest, passed = exp(-extinction * stride);
    most = max(most, extinction);
    light += clear * (1. - passed) * voxel.g;
    clear *= passed;
  }
  if (colouring == 0) colour = vec4(vec3(light), 1. - clear);
  else { float opacity = smoothstep(0., .15, most / shown);
    colour = vec4(texture(palette, vec2(min(most / shown, .998), .5)).rgb * opacity, opacity); }
}`];
const add = (a, b, share = 1) => a.map((part, n) => part + share * b[n]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const extent = cloud.shape.map((count, n) => count * cloud.spacing[n]);
const radius = Math.hypot(...extent) / 2;
const turned = {zenith: scene.eye[0], azimuth: scene.eye[1]};

// As `sunlight` in volume.py: what is left of the sunlight in every voxel, from the top layer down.
function sunlight(data) {
  const up = Math.max(scene.light[2], .1), light = new Float32Array(data.length), half = cloud.spacing[2] / up / 2;
  const aside = [0, 1].map(n => scene.light[n] / up * cloud.spacing[2] / cloud.spacing[n]);
  let above = null;
  for (let k = nz - 1; k >= 0; k--) {
    const depth = new Float32Array(nx * ny);
    for (let i = 0; i < nx; i++) for (let j = 0; j < ny; j++) {
      let sum = 0;
      if (above) {
        const x = i + aside[0], y = j + aside[1], i0 = Math.floor(x), j0 = Math.floor(y);
        for (const [di, dj] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
          const a = i0 + di, b = j0 + dj, share = (di ? x - i0 : 1 - x + i0) * (dj ? y - j0 : 1 - y + j0);
          if (a >= 0 && b >= 0 && a < nx && b < ny)
            sum += share * (above[a * ny + b] + half * at(data, a, b, k + 1));
        }
      }
      depth[i * ny + j] = sum + half * at(data, i, j, k);
      light[(i * ny + j) * nz + k] = scene.ambient + (1 - scene.ambient) * Math.exp(-scene.lost * depth[i * ny + j]);
    }
    above = depth;
  }
  return light;
}

function texture(gl, data, largest) {
  const light = sunlight(data), texels = new Uint8Array(2 * data.length);
  for (let i = 0, n = 0; i < nx; i++) for (let j = 0; j < ny; j++) for (let k = 0; k < nz; k++, n++) {
    const place = 2 * ((k * ny + j) * nx + i);
    texels[place] = Math.round(255 * Math.sqrt(Math.min(data[n] * cloud.step / largest, 1)));
    texels[place + 1] = Math.round(255 * light[n]);
  }
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.bindTexture(gl.TEXTURE_3D, gl.createTexture());
  gl.texImage3D(gl.TEXTURE_3D, 0, gl.RG8, nx, ny, nz, 0, gl.RG, gl.UNSIGNED_BYTE, texels);
  for (const side of ['S', 'T', 'R']) gl.texParameteri(gl.TEXTURE_3D, gl['TEXTURE_WRAP_' + side], gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
}

function palette(gl) {
  gl.activeTexture(gl.TEXTURE1);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  const texels = Uint8Array.from(cloud.sequential.flat());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, cloud.sequential.length, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, texels);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.activeTexture(gl.TEXTURE0);
}

function program(gl) {
  const made = gl.createProgram();
  shaders.forEach((text, n) => {
    const shader = gl.createShader(n ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(made, shader);
  });
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) return null;
  gl.useProgram(made);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
  const corner = gl.getAttribLocation(made, 'corner');
  gl.enableVertexAttribArray(corner); gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
  return made;
}

// What one volume is drawn on: lines behind it, itself, lines before it. Null where WebGL 2 is not to be had.
function stage(volume) {
  const figure = document.createElement('figure'), caption = document.createElement('figcaption');
  const frame = document.createElement('div'), layers = ['2d', 'webgl2', '2d'].map(kind => {
    const canvas = document.createElement('canvas');
    frame.append(canvas);
    return canvas.getContext(kind, kind === 'webgl2' ? {premultipliedAlpha: true, preserveDrawingBuffer: true} : {});
  });
  const gl = layers[1];
  if (!gl || Math.max(nx, ny, nz) > gl.getParameter(gl.MAX_3D_TEXTURE_SIZE)) return null;
  const made = program(gl), largest = Math.max(volume.data.reduce((a, b) => Math.max(a, b), 0) * cloud.step, 1e-9);
  if (!made) return null;
  texture(gl, volume.data, largest); palette(gl);
  caption.textContent = volume.name; frame.className = 'stage'; frame.tabIndex = 0;
  frame.style.background = scene.colours.sky;
  frame.setAttribute('role', 'img');
  frame.setAttribute('aria-label', `${volume.name} cloud in three dimensions: arrow keys turn it`);
  figure.append(caption, frame);
  return {figure, frame, layers, made, largest};
}

function axesOfEye() {
  const [t, p] = [turned.zenith, turned.azimuth].map(angle => angle * Math.PI / 180);
  const towards = [Math.sin(t) * Math.cos(p), Math.sin(t) * Math.sin(p), Math.cos(t)];
  const right = [-Math.sin(p), Math.cos(p), 0];
  const up = [towards[1] * right[2] - towards[2] * right[1], towards[2] * right[0] - towards[0] * right[2],
    towards[0] * right[1] - towards[1] * right[0]];
  return {right, up, towards};
}

// Calls draw(context, from, to, style) for edges, north, scale, sensors and sun; points are from the centre, km.
function overlay(eye, marks, line, label) {
  const half = extent.map(length => length / 2), nearest = eye.towards.map(part => Math.sign(part) || 1);
  for (let n = 0; n < 3; n++) for (const a of [-1, 1]) for (const b of [-1, 1]) {
    const [one, other] = [0, 1, 2].filter(m => m !== n), start = [0, 0, 0], end = [0, 0, 0];
    start[n] = -half[n]; end[n] = half[n];
    start[one] = end[one] = a * half[one]; start[other] = end[other] = b * half[other];
    line(a === nearest[one] && b === nearest[other], start, end, scene.colours.lines, 1, false);
  }
  const [x, y, z] = half, below = eye.towards[2] < 0, long = lengthOfBar();
  line(!below, [-x, -1.12 * y, -z], [-x + long, -1.12 * y, -z], '#fff', 3, false);
  label(!below, [-x + long / 2, -1.35 * y, -z], `${long} km`, '#fff', '');
  line(!below, [1.12 * x, -.6 * y, -z], [1.12 * x, 0, -z], '#fff', 2, true);
  label(!below, [1.12 * x, .18 * y, -z], 'N', '#fff', '');
  if (!marks) return;
  const all = scene.sensors.map(one => [one.name, one.towards, scene.distances.sensor, scene.colours.sensors, '#fff']);
  if (scene.sun) all.push(['sun', scene.light, scene.distances.sun, scene.colours.sun, '#000']);
  for (const [text, towards, distance, colour, ink] of all) {
    const start = towards.map(part => part * distance * radius), front = dot(towards, eye.towards) > 0;
    line(front, start, start.map(part => part * scene.distances.nearer), colour, 2, true);
    label(front, start, text, ink, colour);
  }
}
const lengthOfBar = () => { const step = tickStep(extent[0] / 5); return +step.toPrecision(1); };

// What must be seen lies in a square of twice `reach` around `middle`; its size does not change while it is turned.
function frameOf(eye, marks) {
  const half = extent.map(length => length / 2), points = [];
  for (const a of [-1, 1]) for (const b of [-1, 1]) for (const c of [-1, 1]) points.push([a * half[0], b * half[1], c * half[2]]);
  const far = marks ? (scene.sun ? scene.distances.sun : scene.sensors.length ? scene.distances.sensor : 1) : 1;
  if (marks) {
    for (const one of scene.sensors) points.push(one.towards.map(part => part * scene.distances.sensor * radius));
    if (scene.sun) points.push(scene.light.map(part => part * scene.distances.sun * radius));
  }
  const middle = [eye.right, eye.up].map(axis => {
    const places = points.map(point => dot(point, axis));
    return (Math.max(...places) + Math.min(...places)) / 2;
  });
  return {middle, reach: radius * ((1 + far) / 2 + .1)};
}

function drawStage(one) {
  const eye = axesOfEye(), ratio = Math.min(window.devicePixelRatio || 1, 2), size = Math.round(one.frame.clientWidth * ratio);
  const marks = document.getElementById('marks').checked, gl = one.layers[1];
  const {middle, reach} = frameOf(eye, marks);
  const halfWidth = reach / document.getElementById('zoom').value;
  for (const layer of one.layers) { layer.canvas.width = size; layer.canvas.height = size; }
  const seen = point => [size / 2 * (1 + (dot(point, eye.right) - middle[0]) / halfWidth),
    size / 2 * (1 - (dot(point, eye.up) - middle[1]) / halfWidth)];
  const line = (front, from, to, colour, width, arrow) => {
    const context = one.layers[front ? 2 : 0], [a, b] = [seen(from), seen(to)];
    context.strokeStyle = context.fillStyle = colour; context.lineWidth = width * ratio;
    context.globalAlpha = front && width === 1 ? .5 : 1;
    context.beginPath(); context.moveTo(...a); context.lineTo(...b); context.stroke();
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (arrow && length > 1) {
      const [x, y] = [(b[0] - a[0]) / length * 7 * ratio, (b[1] - a[1]) / length * 7 * ratio];
      context.beginPath(); context.moveTo(b[0] + x / 2, b[1] + y / 2);
      context.lineTo(b[0] - x / 2 - y / 2, b[1] - y / 2 + x / 2); context.lineTo(b[0] - x / 2 + y / 2, b[1] - y / 2 - x / 2);
      context.fill();
    }
    context.globalAlpha = 1;
  };
  const label = (front, point, text, ink, ground) => {
    const context = one.layers[front ? 2 : 0], [x, y] = seen(point);
    context.font = `${(ground ? 10 : 13) * ratio}px system-ui, sans-serif`;
    context.textAlign = 'center'; context.textBaseline = 'middle';
    if (ground) {
      context.fillStyle = ground; context.beginPath();
      context.arc(x, y, Math.max(8 * ratio, context.measureText(text).width / 2 + 3 * ratio), 0, 7); context.fill();
    }
    context.fillStyle = ink; context.fillText(text, x, y);
  };
  overlay(eye, marks, line, label);
  gl.viewport(0, 0, size, size);
  gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT);
  const of = name => gl.getUniformLocation(one.made, name);
  gl.uniform3fv(of('right'), eye.right); gl.uniform3fv(of('up'), eye.up);
  gl.uniform3fv(of('towards'), eye.towards.map(part => Math.abs(part) < 1e-6 ? 1e-6 : part));
  gl.uniform2fv(of('middle'), middle); gl.uniform3fv(of('extent'), extent); gl.uniform1f(of('half_width'), halfWidth);
  gl.uniform1f(of('largest'), one.largest); gl.uniform1f(of('shown'), cloud.largest);
  gl.uniform1f(of('stride'), Math.max(Math.min(Math.min(...cloud.spacing) / 2, radius / 60), radius / 349));
  gl.uniform1i(of('colouring'), +document.getElementById('colouring').value);
  gl.uniform1i(of('volume'), 0); gl.uniform1i(of('palette'), 1);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

const stages = volumes.map(stage);
if (stages.every(one => one)) {
  const hold = document.getElementById('stages'), choice = document.getElementById('eye');
  let waiting = false;
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false; stages.forEach(drawStage);
      hold.dataset.azimuth = turned.azimuth.toFixed(1); hold.dataset.zenith = turned.zenith.toFixed(1);
    });
  };
  const turn = (azimuth, zenith) => {
    turned.azimuth = (turned.azimuth + azimuth + 360) % 360;
    turned.zenith = Math.max(.01, Math.min(179.99, turned.zenith + zenith));
    choice.value = ''; redraw();
  };
  for (const one of stages) {
    hold.append(one.figure);
    one.frame.onpointerdown = event => { one.frame.setPointerCapture(event.pointerId); one.last = [event.clientX, event.clientY]; };
    one.frame.onpointerup = one.frame.onpointercancel = () => { one.last = null; };
    one.frame.onpointermove = event => {
      if (!one.last) return;
      turn(-.5 * (event.clientX - one.last[0]), -.5 * (event.clientY - one.last[1]));
      one.last = [event.clientX, event.clientY];
    };
    one.frame.onkeydown = event => {
      const steps = {ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, -5], ArrowDown: [0, 5]}[event.key];
      if (steps) { turn(...steps); event.preventDefault(); }
    };
  }
  choice.oninput = () => {
    if (!choice.value) return;
    [turned.zenith, turned.azimuth] = choice.value.split(',').map(Number);
    redraw();
  };
  for (const name of ['colouring', 'zoom', 'marks']) document.getElementById(name).oninput = redraw;
  for (const name of ['stages', 'look', 'turning']) document.getElementById(name).hidden = false;
  document.getElementById('flat').hidden = true;
  window.addEventListener('resize', redraw);
  redraw();
}
