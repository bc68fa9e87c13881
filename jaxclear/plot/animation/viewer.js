// The page beside the scene: names of bodies, insets of joints, play, pause and the time.
// RUN holds the data, K3DInstance the scene; nothing is loaded from elsewhere.
(function () {
  'use strict';
  const WIDE = 330, LOW = 52, JOURNAL = 42, GAP = 34;
  const unpack = (o) => {
    if (o === null || typeof o !== 'object') return o;
    if (o.f32 !== undefined) {
      const text = atob(o.f32), bytes = new Uint8Array(text.length);
      for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
      const flat = new Float32Array(bytes.buffer);
      flat.shape = o.shape;
      return flat;
    }
    if (o.u8 !== undefined) return Uint8Array.from(atob(o.u8), (c) => c.charCodeAt(0));
    for (const key of Object.keys(o)) o[key] = unpack(o[key]);
    return o;
  };
  // Below so many pixels of width the insets stand below the scene, which takes this share.
  const NARROW = 720, SCENE = 0.5;
  const newton = (f) => {
    const [per, unit] = [[1e9, 'GN'], [1e6, 'MN'], [1e3, 'kN']].find(([per]) => f >= per) || [1, 'N'];
    return `${Number((f / per).toPrecision(3))} ${unit}`;
  };
  const run = unpack(RUN), time = run.time, frames = time.length;
  const first = time[0], end = time[frames - 1];
  const make = (kind, parent, style, text) => {
    const one = document.createElement(kind);
    Object.assign(one.style, style);
    if (text !== undefined) one.textContent = text;
    parent.appendChild(one);
    return one;
  };
  const font = '13px system-ui, sans-serif';
  document.title = run.title || 'jaxclear';
  const wide = run.joints.length ? WIDE : 0;
  const target = document.getElementById('canvasTarget');
  Object.assign(target.style, { position: 'absolute', left: 0, top: 0 });

  // Names of bodies: a list, and a label that follows each.
  const list = make('div', document.body, {
    position: 'absolute', left: '10px', top: '8px', font, background: 'rgba(255,255,255,0.6)',
    padding: '4px 8px', borderRadius: '4px', maxWidth: '45%', zIndex: 20,
  });
  list.id = 'bodies';
  if (run.title) make('div', list, { fontWeight: 600 }, run.title);
  const labels = run.bodies.map((body) => {
    const row = make('div', list, {});
    make('span', row, { color: body.colour }, '\u25A0 ');
    make('span', row, {}, body.name);
    return make('div', target, {
      position: 'absolute', font, color: body.colour, pointerEvents: 'none', fontWeight: 600,
      textShadow: '0 0 3px #fff, 0 0 3px #fff, 0 0 3px #fff', zIndex: 10,
    }, body.name);
  });
  const ground = make('div', list, {});
  make('span', ground, { color: run.ground }, '\u25A0 ');
  make('span', ground, {}, 'ground');
  if (run.largest > 0) {
    const row = make('div', list, {});
    make('span', row, { color: '#c23b22' }, '\u2192 ');
    make('span', row, {}, `Contact forces, up to ${newton(run.largest)}.`);
  }
  const said = make('div', document.body, {
    left: '10px', bottom: `${LOW + 6}px`, font: '11px sans-serif', color: '#b3261e',
    overflowY: 'auto', zIndex: 20, background: 'rgba(255,255,255,0.8)',
  });
  run.warnings.forEach((text) => make('div', said, {}, 'Warning: ' + text));

  // Insets of the joints.
  const side = make('div', document.body, {
    position: 'absolute', right: 0, bottom: `${LOW}px`, overflowY: 'auto', background: '#fafafa',
    border: wide ? '1px solid #ddd' : '', boxSizing: 'border-box',
  });
  side.id = 'insets';
  // Beside the scene, or below it where the page is narrow.
  const arrange = () => {
    const narrow = wide > 0 && window.innerWidth < NARROW;
    const tall = window.innerHeight - LOW, high = narrow ? Math.round(SCENE * tall) : tall;
    const broad = window.innerWidth - (narrow ? 0 : wide);
    Object.assign(target.style, { width: `${broad}px`, height: `${high}px` });
    Object.assign(side.style, {
      width: `${narrow ? broad : wide}px`, height: `${narrow ? tall - high : tall}px`,
    });
    if (narrow) side.prepend(said); else document.body.append(said);
    Object.assign(said.style, narrow
      ? { position: 'static', width: 'auto', maxHeight: 'none', margin: '4px 10px' }
      : { position: 'absolute', width: `${broad - 90}px`, maxHeight: '15%', margin: 0 });
    list.style.fontSize = narrow ? '11px' : '13px';
    pace.style.display = narrow ? 'none' : '';
  };
  const sharp = window.devicePixelRatio || 1;
  const TALL = { round: 190, slot: 176, bars: 110 };
  run.joints.forEach((joint) => {
    make('div', side, { font, fontWeight: 600, margin: '6px 10px 0' }, 'Joint ' + joint.name);
    const height = TALL[joint.views[0].kind] + (joint.views.some((v) => v.worn) ? 112 : 84);
    const canvas = make('canvas', side, { width: `${WIDE - 20}px`, height: `${height}px` });
    canvas.width = (WIDE - 20) * sharp;
    canvas.height = height * sharp;
    joint.pen = canvas.getContext('2d');
    joint.tall = height;
    joint.reach = Math.max(...joint.views.map((view) => {
      let most = joint.clearance;
      if (view.wall) for (let i = 0; i < view.wall.length; i += 2)
        most = Math.max(most, Math.hypot(view.wall[i], view.wall[i + 1]));
      return most;
    })) || 1;
    joint.worn = Math.max(0, ...joint.views.map((v) => v.worn ? Math.max(...v.worn) : 0));
  });
  // From pale to dark, as in matplotlib's YlOrRd.
  const heat = (x) => {
    const stops = [[255, 255, 204], [254, 217, 118], [253, 141, 60], [227, 26, 28], [128, 0, 38]];
    const at = Math.min(Math.max(x, 0), 1) * 4, i = Math.min(Math.floor(at), 3), f = at - i;
    return `rgb(${stops[i].map((c, k) => Math.round(c + f * (stops[i + 1][k] - c))).join(',')})`;
  };
  const arrow = (pen, x, y, dx, dy, colour) => {
    const long = Math.hypot(dx, dy);
    if (long < 1) return;
    const ux = dx / long, uy = dy / long;
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x + dx, y + dy);
    pen.stroke();
    pen.beginPath();
    pen.moveTo(x + dx + 4 * ux, y + dy + 4 * uy);
    pen.lineTo(x + dx - 5 * ux - 4 * uy, y + dy - 5 * uy + 4 * ux);
    pen.lineTo(x + dx - 5 * ux + 4 * uy, y + dy - 5 * uy - 4 * ux);
    pen.fill();
  };
  const shown = (metres) => {
    const size = Math.abs(metres);
    const [per, unit] = [[1e3, 'mm'], [1e6, '\u00b5m'], [1e9, 'nm'], [1e12, 'pm'], [1e15, 'fm']]
      .find(([factor]) => size * factor >= 1 || size === 0) || [1e18, 'am'];
    return `${Number((metres * per).toPrecision(3))} ${unit}`;
  };
  const forceOf = (joint, frame, contact) => joint.force[frame * joint.contacts.length + contact];
  const depthOf = (joint, frame, contact) => joint.depth[frame * joint.contacts.length + contact];
  const long = (joint, force) => 8 + 30 * Math.sqrt(force / (joint.most || 1));

  const round = (joint, view, frame, cx, cy, radius) => {
    const pen = joint.pen, scale = radius * GAP / (JOURNAL + GAP) / joint.reach;
    const own = radius * JOURNAL / (JOURNAL + GAP);
    const count = view.wall.length / 2;
    const edge = (i, more) => {
      const x = view.wall[2 * i], y = view.wall[2 * i + 1], r = Math.hypot(x, y) || 1;
      const px = scale * x + (own + more) * x / r, py = scale * y + (own + more) * y / r;
      return [cx + px, cy - py];
    };
    // The bearing, its colour the depth that is worn by now.
    const sectors = view.grown ? view.grown.length / frames : 0;
    for (let i = 0; i < count; i++) {
      const j = (i + 1) % count;
      pen.beginPath();
      pen.moveTo(...edge(i, 0)); pen.lineTo(...edge(j, 0));
      pen.lineTo(...edge(j, 13)); pen.lineTo(...edge(i, 13));
      const sector = Math.floor(i * sectors / count);
      const depth = view.worn && view.worn[Math.floor(i * view.worn.length / count)]
        * view.grown[frame * sectors + sector] / 255;
      pen.fillStyle = pen.strokeStyle = view.worn
        ? heat(Math.sqrt(depth / (joint.worn || 1))) : '#c3c8cf';
      pen.lineWidth = 0.7;
      pen.fill();
      pen.stroke();
    }
    pen.strokeStyle = '#444';
    pen.lineWidth = 1;
    for (const more of [0, 13]) {
      pen.beginPath();
      for (let i = 0; i <= count; i++) pen.lineTo(...edge(i % count, more));
      pen.stroke();
    }
    const place = (f) => [cx + scale * view.centre[2 * f], cy - scale * view.centre[2 * f + 1]];
    const [x, y] = place(frame);
    pen.beginPath();
    pen.arc(x, y, own, 0, 2 * Math.PI);
    pen.fillStyle = 'rgba(74,127,176,0.25)';
    pen.fill();
    pen.strokeStyle = '#2f5f8f';
    pen.lineWidth = 1.5;
    pen.stroke();
    pen.beginPath();
    for (let f = Math.max(0, frame - 90); f <= frame; f++) pen.lineTo(...place(f));
    pen.strokeStyle = 'rgba(47,95,143,0.55)';
    pen.lineWidth = 1;
    pen.stroke();
    pen.fillStyle = '#2f5f8f';
    pen.beginPath();
    pen.arc(x, y, 2.5, 0, 2 * Math.PI);
    pen.fill();
    pen.strokeStyle = '#999';
    pen.beginPath();
    pen.moveTo(cx - 4, cy); pen.lineTo(cx + 4, cy); pen.moveTo(cx, cy - 4); pen.lineTo(cx, cy + 4);
    pen.stroke();
    view.of.forEach((contact, k) => {
      const force = forceOf(joint, frame, contact), at = 2 * (frame * view.of.length + k);
      const wx = view.ways[at], wy = view.ways[at + 1];
      if (depthOf(joint, frame, contact) <= 0 && force <= 0) return;
      const px = x + own * wx, py = y - own * wy, reach = long(joint, force);
      if (force > 0) arrow(pen, px, py, -reach * wx, reach * wy, '#c23b22');
      pen.beginPath();
      pen.arc(px, py, 4, 0, 2 * Math.PI);
      pen.fillStyle = '#c23b22';
      pen.fill();
    });
  };

  const slot = (joint, view, frame, cx, cy) => {
    const pen = joint.pen, half = 34, across = 120, scale = 22 / joint.clearance;
    pen.fillStyle = '#c3c8cf';
    pen.strokeStyle = '#444';
    for (const up of [-1, 1]) {
      const y = cy - up * (half + 22);
      pen.fillRect(cx - across - 20, up > 0 ? y - 12 : y, 2 * across + 40, 12);
      pen.beginPath();
      pen.moveTo(cx - across - 20, y); pen.lineTo(cx + across + 20, y);
      pen.stroke();
    }
    // Corners: lower back, lower front, upper back, upper front.
    const corner = (i) => {
      const up = i < 2 ? -1 : 1, front = i % 2 ? 1 : -1;
      return [cx + front * across, cy - up * (half + 22 + scale * depthOf(joint, frame, i)), up];
    };
    pen.beginPath();
    for (const i of [0, 1, 3, 2]) pen.lineTo(...corner(i).slice(0, 2));
    pen.closePath();
    pen.fillStyle = 'rgba(74,127,176,0.25)';
    pen.fill();
    pen.strokeStyle = '#2f5f8f';
    pen.lineWidth = 1.5;
    pen.stroke();
    view.of.forEach((i) => {
      const force = forceOf(joint, frame, i), [x, y, up] = corner(i);
      if (depthOf(joint, frame, i) <= 0 && force <= 0) return;
      if (force > 0) arrow(pen, x, y, 0, up * long(joint, force), '#c23b22');
      pen.beginPath();
      pen.arc(x, y, 4, 0, 2 * Math.PI);
      pen.fillStyle = '#c23b22';
      pen.fill();
    });
  };

  const bars = (joint, view, frame) => {
    const pen = joint.pen;
    view.of.forEach((i, row) => {
      const depth = depthOf(joint, frame, i), y = 24 + 16 * row;
      pen.fillStyle = depth > 0 ? '#c23b22' : '#555';
      pen.fillText(`${joint.contacts[i]}: ${shown(depth)}`, 12, y);
    });
  };

  const chart = (joint, now, top) => {
    const pen = joint.pen, left = 8, wide = WIDE - 36, tall = 38, count = joint.chart.shape[0];
    pen.strokeStyle = '#bbb';
    pen.lineWidth = 1;
    pen.strokeRect(left, top, wide, tall);
    pen.fillStyle = '#c23b22';
    for (let i = 0; i < count; i++) {
      const x = left + wide * i / count;
      const y = tall * joint.chart[2 * i + 1] / (joint.most || 1);
      pen.fillRect(x, top + tall - y, Math.max(wide / count, 0.7), y);
    }
    const x = left + wide * (now - first) / (end - first || 1);
    pen.strokeStyle = '#000';
    pen.beginPath();
    pen.moveTo(x, top); pen.lineTo(x, top + tall);
    pen.stroke();
    pen.fillStyle = '#555';
    pen.font = '11px system-ui, sans-serif';
    pen.fillText(`Saved normal forces, together up to ${newton(joint.most)};`, left, top + tall + 13);
    pen.fillText(`a contact's largest in all steps is ${newton(joint.peak)}.`, left, top + tall + 27);
  };

  const draw = (joint, frame, now) => {
    const pen = joint.pen, kind = joint.views[0].kind, tall = TALL[kind];
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.clearRect(0, 0, WIDE, joint.tall);
    pen.font = '11px system-ui, sans-serif';
    const count = joint.views.length, room = WIDE - 20;
    joint.views.forEach((view, k) => {
      pen.fillStyle = '#555';
      const cx = room * (k + 0.5) / count;
      pen.textAlign = 'center';
      pen.fillText(view.title, cx, 11);
      pen.textAlign = 'left';
      const radius = Math.min(room / count / 2 - 18, tall / 2 - 26);
      if (view.kind === 'round') round(joint, view, frame, cx, tall / 2 + 2, radius);
      else if (view.kind === 'slot') slot(joint, view, frame, cx, tall / 2);
      else bars(joint, view, frame);
    });
    let force = 0, touching = 0;
    joint.contacts.forEach((_, i) => {
      force += forceOf(joint, frame, i);
      touching += forceOf(joint, frame, i) > 0 || depthOf(joint, frame, i) > 0;
    });
    pen.fillStyle = '#222';
    pen.textAlign = 'left';
    const state = touching ? `${touching} in contact, ${newton(force)}` : 'free flight';
    pen.fillText(`clearance ${shown(joint.clearance)}, gap magnified; ${state}`, 8, tall + 2);
    if (joint.worn > 0) {
      for (let i = 0; i < 60; i++) {
        pen.fillStyle = heat(Math.sqrt(i / 59));
        pen.fillRect(8 + i, tall + 9, 1.5, 7);
      }
      pen.fillStyle = '#555';
      pen.fillText('The wall\'s colour is its worn depth by now,', 76, tall + 16);
      pen.fillText(`from nothing to ${shown(joint.worn)}, the deepest at the end.`, 8, tall + 30);
    }
    chart(joint, now, tall + (joint.worn > 0 ? 38 : 10));
  };

  // Play, pause and time.
  const bar = make('div', document.body, {
    position: 'absolute', left: 0, right: 0, bottom: 0, height: `${LOW}px`, display: 'flex',
    alignItems: 'center', gap: '12px', padding: '0 12px', font, boxSizing: 'border-box',
    background: '#f1f3f5', borderTop: '1px solid #ddd', zIndex: 30,
  });
  const button = make('button', bar, { minWidth: '60px', height: '30px', font }, 'Pause');
  button.id = 'play';
  const slider = make('input', bar, { flex: 1, minWidth: '60px' });
  slider.id = 'time';
  Object.assign(slider, { type: 'range', min: first, max: end, step: (end - first) / 2000 });
  const clock = make('span', bar, { fontVariantNumeric: 'tabular-nums', whiteSpace: 'nowrap' });
  const speed = make('select', bar, { font });
  speed.id = 'speed';
  [8, 4, 2, 1, 0.5, 0.25, 0.1].forEach((x) => {
    const one = make('option', speed, {}, x === 1 ? '\u00d7 1' : `\u00d7 ${x}`);
    one.value = x;
    one.selected = x === 1;
  });
  const pace = make('span', bar, { color: '#555' }, run.slower === 1 ? 'real time'
    : run.slower > 1 ? `${run.slower.toPrecision(3)} times slower`
      : `${(1 / run.slower).toPrecision(3)} times faster`);

  // Arrows of forces are seen through the bodies.
  const overlaid = new Set();
  const overlay = () => {
    if (overlaid.size === run.arrows.length) return;
    K3DInstance.getWorld().K3DObjects.children.forEach((one) => {
      if (!run.arrows.includes(one.K3DIdentifier) || overlaid.has(one.K3DIdentifier)) return;
      overlaid.add(one.K3DIdentifier);
      one.traverse((part) => {
        if (!part.material) return;
        Object.assign(part.material, { depthTest: false, depthWrite: false, transparent: true });
        part.renderOrder = 1000;
      });
    });
  };
  const state = { playing: true, now: first, before: 0 };
  const frameAt = (now) => {
    let low = 0, high = frames - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (time[middle] <= now) low = middle; else high = middle;
    }
    return now - time[low] < time[high] - now ? low : high;
  };
  const follow = (frame) => {
    const camera = K3DInstance.getWorld().camera;
    const v = camera.matrixWorldInverse.elements, p = camera.projectionMatrix.elements;
    const apply = (m, a) => [0, 1, 2, 3].map(
      (i) => m[i] * a[0] + m[i + 4] * a[1] + m[i + 8] * a[2] + m[i + 12] * a[3]);
    // A name that would lie on another one stands below it.
    const placed = [];
    run.bodies.forEach((body, k) => {
      const at = [0, 1, 2].map((i) => body.com[3 * frame + i]);
      const clip = apply(p, apply(v, [...at, 1])), style = labels[k].style;
      const inside = clip[3] > 0 && Math.abs(clip[0]) < clip[3] && Math.abs(clip[1]) < clip[3];
      style.display = inside ? '' : 'none';
      if (!inside) return;
      const left = (0.5 + 0.5 * clip[0] / clip[3]) * target.clientWidth + 8;
      let top = (0.5 - 0.5 * clip[1] / clip[3]) * target.clientHeight - 8;
      const right = left + labels[k].offsetWidth, height = labels[k].offsetHeight;
      const under = () => placed.find((one) => Math.abs(one.top - top) < height
        && left < one.right && one.left < right);
      for (let one = under(); one; one = under()) top = one.top + height;
      placed.push({ left, right, top });
      style.left = `${left}px`;
      style.top = `${top}px`;
    });
  };
  const show = () => {
    const frame = frameAt(state.now);
    K3DInstance.setTime(state.now);
    overlay();
    run.joints.forEach((joint) => draw(joint, frame, state.now));
    follow(frame);
    slider.value = state.now;
    clock.textContent = `${(state.now - first).toPrecision(4)} of ${(end - first).toPrecision(4)} s`;
    button.textContent = state.playing ? 'Pause' : 'Play';
  };
  const step = (stamp) => {
    if (state.playing) {
      const passed = Math.min((stamp - state.before) / 1e3, 0.1) * speed.value / run.slower;
      state.now += passed;
      if (state.now > end) state.now = first;
      show();
    } else follow(frameAt(state.now));
    state.before = stamp;
    requestAnimationFrame(step);
  };
  button.onclick = () => { state.playing = !state.playing; show(); };
  slider.oninput = () => { state.playing = false; state.now = +slider.value; show(); };
  document.addEventListener('keydown', (event) => {
    if (event.code === 'Space') { event.preventDefault(); button.onclick(); }
  });
  // For tests and for who embeds the page: animation.go(seconds) stops there.
  window.animation = {
    go: (seconds) => { state.playing = false; state.now = first + seconds; show(); },
    state, frames,
  };
  arrange();
  window.addEventListener('resize', arrange, true);
  window.dispatchEvent(new Event('resize'));
  const asked = new URLSearchParams(location.hash.slice(1)).get('t');
  if (asked !== null) window.animation.go(+asked);
  requestAnimationFrame((stamp) => { state.before = stamp; show(); step(stamp); });
  document.body.dataset.ready = 'yes';
})();
