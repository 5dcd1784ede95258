// Layers of the volumes, with axes. Volumes come as unsigned 16-bit numbers, x slowest.
const decode = text => new Uint16Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const volumes = cloud.volumes.map(v => ({name: v.name, data: decode(v.data)}));
const [nx, ny, nz] = cloud.shape, names = ['x', 'y', 'z'], titles = ['x, east (km)', 'y, north (km)', 'z, up (km)'];
const at = (data, i, j, k) => data[(i * ny + j) * nz + k] * cloud.step;
const panels = volumes.map(v => ({title: v.name, colours: cloud.sequential, low: 0, high: cloud.largest,
  value: (i, j, k) => at(v.data, i, j, k)}));
if (volumes.length === 2) panels.push({title: 'recovered - true', colours: cloud.diverging,
  low: -cloud.largest, high: cloud.largest,
  value: (i, j, k) => at(volumes[1].data, i, j, k) - at(volumes[0].data, i, j, k)});
const holder = document.getElementById('panels');
for (const panel of panels) {
  const figure = document.createElement('figure'), caption = document.createElement('figcaption');
  panel.canvas = document.createElement('canvas');
  panel.canvas.setAttribute('role', 'img');
  caption.textContent = panel.title;
  const bar = document.createElement('div'), ends = document.createElement('div');
  bar.className = 'bar'; ends.className = 'ends';
  bar.style.background = 'linear-gradient(to right,' + panel.colours.filter((c, n) => n % 16 === 0 || n === 255)
    .map(c => 'rgb(' + c.join(',') + ')').join(',') + ')';
  for (const text of [panel.low.toPrecision(3), 'extinction, km⁻¹', panel.high.toPrecision(3)]) {
    const span = document.createElement('span'); span.textContent = text; ends.append(span);
  }
  figure.append(caption, panel.canvas, bar, ends); holder.append(figure);
}
const axis = document.getElementById('axis'), slice = document.getElementById('slice');
const where = document.getElementById('where'), value = document.getElementById('value');
const plane = normal => [0, 1, 2].filter(other => other !== normal);
function voxel(normal, index, column, row) {
  const [right, up] = plane(normal), place = [0, 0, 0];
  place[normal] = index; place[right] = column; place[up] = row;
  return place;
}
// The step of ticks: 1, 2 or 5 times a power of ten, at least `least` apart.
function tickStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map(digit => digit * power).find(step => step >= least * (1 - 1e-9));
}
function pixels(panel, normal, index, width, height) {
  const image = new ImageData(width, height);
  for (let row = 0; row < height; row++) for (let column = 0; column < width; column++) {
    const share = (panel.value(...voxel(normal, index, column, row)) - panel.low) / (panel.high - panel.low);
    const colour = panel.colours[Math.max(0, Math.min(255, Math.round(share * 255)))];
    image.data.set([...colour, 255], 4 * ((height - 1 - row) * width + column));
  }
  const canvas = document.createElement('canvas');
  canvas.width = width; canvas.height = height;
  canvas.getContext('2d').putImageData(image, 0, 0);
  return canvas;
}
function ticks(context, box, right, up) {
  context.textAlign = 'center'; context.textBaseline = 'top';
  for (const [along, start, length] of [[right, box.left, box.width], [up, box.bottom, box.height]]) {
    const scale = length / (cloud.shape[along] * cloud.spacing[along]), step = tickStep(48 / scale);
    const first = Math.ceil(cloud.origin[along] / step - 1e-9) * step, digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let n = 0; ; n++) {
      const place = first + n * step, offset = (place - cloud.origin[along]) * scale;
      if (offset > length + .5) break;
      context.beginPath();
      if (along === right) {
        context.moveTo(start + offset, box.bottom); context.lineTo(start + offset, box.bottom + 4); context.stroke();
        context.fillText(place.toFixed(digits), start + offset, box.bottom + 6);
      } else {
        context.moveTo(box.left - 4, start - offset); context.lineTo(box.left, start - offset); context.stroke();
        context.save(); context.textAlign = 'right'; context.textBaseline = 'middle';
        context.fillText(place.toFixed(digits), box.left - 6, start - offset); context.restore();
      }
    }
  }
  context.fillText(titles[right], box.left + box.width / 2, box.bottom + 21);
  context.save(); context.translate(10, box.bottom - box.height / 2); context.rotate(-Math.PI / 2);
  context.textBaseline = 'middle'; context.fillText(titles[up], 0, 0); context.restore();
}
function drawSlices() {
  const normal = +axis.value, index = +slice.value, [right, up] = plane(normal);
  const width = cloud.shape[right], height = cloud.shape[up], ratio = window.devicePixelRatio || 1;
  const wide = width * cloud.spacing[right], tall = height * cloud.spacing[up], style = getComputedStyle(document.body);
  for (const panel of panels) {
    const canvas = panel.canvas, space = canvas.parentElement.clientWidth, margin = {left: 52, bottom: 40, top: 8, right: 12};
    const scale = Math.min((space - margin.left - margin.right) / wide, 360 / tall);
    const box = {left: margin.left, width: wide * scale, height: tall * scale, bottom: margin.top + tall * scale};
    const high = box.bottom + margin.bottom;
    canvas.width = space * ratio; canvas.height = high * ratio; canvas.style.height = high + 'px';
    const context = canvas.getContext('2d');
    context.scale(ratio, ratio); context.imageSmoothingEnabled = false;
    context.drawImage(pixels(panel, normal, index, width, height), box.left, margin.top, box.width, box.height);
    context.strokeStyle = context.fillStyle = style.color; context.lineWidth = 1; context.font = '12px system-ui, sans-serif';
    context.strokeRect(box.left, margin.top, box.width, box.height);
    ticks(context, box, right, up);
    canvas.setAttribute('aria-label', `${panel.title}: extinction across ${names[normal]}`);
    canvas.onpointermove = event => {
      const column = Math.floor((event.offsetX - box.left) / box.width * width);
      const row = height - 1 - Math.floor((event.offsetY - margin.top) / box.height * height);
      if (column < 0 || row < 0 || column >= width || row >= height) return;
      const place = voxel(normal, index, column, row);
      const position = place.map((n, a) => (cloud.origin[a] + (n + .5) * cloud.spacing[a]).toFixed(3));
      value.textContent = `x ${position[0]}, y ${position[1]}, z ${position[2]} km: ` +
        panels.map(p => `${p.title} ${p.value(...place).toFixed(1)}`).join(', ') + ' km⁻¹.';
    };
  }
  const position = cloud.origin[normal] + (index + .5) * cloud.spacing[normal];
  where.textContent = `${names[normal]} = ${position.toFixed(3)} km (layer ${index + 1} of ${cloud.shape[normal]})`;
}
function choose() {
  slice.max = cloud.shape[+axis.value] - 1;
  slice.value = cloud.start[+axis.value];
  drawSlices();
}
axis.oninput = choose; slice.oninput = drawSlices; choose();
window.addEventListener('resize', drawSlices);
window.matchMedia('(prefers-color-scheme: dark)').addEventListener('change', drawSlices);
