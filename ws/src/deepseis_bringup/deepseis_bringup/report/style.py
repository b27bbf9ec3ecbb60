"""Style sheet and script of the report page."""

from typing import Final

STYLE: Final = """
:root{color-scheme:light dark;--paper:#fcfcfb;--card:#fff;--ink:#1b1f24;--muted:#68727d;
--line:#e3e6e8;--soft:#f2f4f5;--band:#dfe4e8;--accent:#1f5fa8;--warn:#b3361b;--good:#1f7a52}
@media (prefers-color-scheme:dark){:root{--paper:#111417;--card:#181c20;--ink:#e4e7ea;
--muted:#949ea8;--line:#2a3036;--soft:#20262b;--band:#343c44;--accent:#7fb2ee;--warn:#f0826a;
--good:#5cc394}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%;scroll-padding-top:60px}
body{margin:0;background:var(--paper);color:var(--ink);font:15px/1.5 system-ui,-apple-system,
"Segoe UI",Inter,Roboto,"Helvetica Neue",Arial,sans-serif;font-variant-numeric:tabular-nums}
main,header.top{max-width:1240px;margin:0 auto;padding:0 24px}
header.top{padding-top:36px;padding-bottom:8px}
.kind{margin:0;color:var(--muted);font-size:13px}
h1{font-size:30px;line-height:1.2;letter-spacing:-.015em;margin:2px 0 8px;font-weight:650;
text-wrap:balance}
.lead{font-size:17px;margin:0 0 4px;max-width:68ch}
.when{color:var(--muted);margin:0 0 22px}
h2{font-size:20px;letter-spacing:-.01em;margin:44px 0 14px;font-weight:640;
padding-top:14px;border-top:1px solid var(--line)}
main>h2:first-child{border-top:0;margin-top:20px}
h3{font-size:15px;margin:0 0 2px;font-weight:640}
.caption{color:var(--muted);font-size:13.5px;line-height:1.45;margin:0 0 8px;max-width:74ch}
.tiles{display:grid;grid-template-columns:repeat(4,1fr);gap:1px;background:var(--card);
border:1px solid var(--line);border-radius:10px;overflow:hidden}
.tile{box-shadow:0 0 0 1px var(--line);padding:14px 16px 12px}
.tile dt{color:var(--muted);font-size:13px}
.tile dd{margin:0}
.tile .value{font-size:26px;font-weight:620;letter-spacing:-.02em;line-height:1.25}
.tile .unit{font-size:15px;font-weight:450;color:var(--muted);margin-left:3px;letter-spacing:0}
.tile .more{color:var(--muted);font-size:13px;line-height:1.35}
.bad .value,.bad{color:var(--warn)}
nav{position:sticky;top:0;z-index:5;background:var(--paper);border-bottom:1px solid var(--line);
margin-top:22px}
nav div{max-width:1240px;margin:0 auto;padding:9px 24px;display:flex;gap:6px;align-items:center;
overflow-x:auto;scrollbar-width:none}
nav div::-webkit-scrollbar{display:none}
nav span{color:var(--muted);font-size:13px;margin-right:4px;white-space:nowrap}
nav button{font:inherit;font-size:13px;font-weight:600;border:1px solid var(--line);
background:var(--card);color:var(--ink);border-radius:14px;padding:2px 10px 2px 8px;cursor:pointer;
white-space:nowrap}
nav button i{display:inline-block;width:9px;height:9px;border-radius:50%;margin-right:6px}
nav button[aria-pressed=false]{opacity:.4}
nav button:focus-visible,summary:focus-visible,.scroll:focus-visible{outline:2px solid
var(--accent);outline-offset:2px}
.figures{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:16px}
figure{margin:0;background:var(--card);border:1px solid var(--line);border-radius:10px;
padding:14px 16px 8px;grid-column:1/-1;min-width:0}
figure.half{grid-column:span 1}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(178px,1fr));gap:10px 12px}
.grid h4{margin:0;font-size:13px;font-weight:640}
.scroll{overflow-x:auto;margin:0 -4px}
table{border-collapse:collapse;width:100%;font-size:13.5px}
th,td{text-align:right;padding:5px 6px;border-bottom:1px solid var(--line);white-space:nowrap}
th{font-weight:560;color:var(--muted);font-size:12.5px;vertical-align:bottom;line-height:1.25}
th small{display:block;font-weight:400}
td:first-child,th:first-child,.words td,.words th{text-align:left}
.words td{white-space:normal;vertical-align:top;overflow-wrap:anywhere}
.words td:first-child{white-space:nowrap}
tr:last-child td{border-bottom:0}
td .dot{display:inline-block;width:9px;height:9px;border-radius:50%;margin-right:7px}
.values{color:var(--muted);font-size:12.5px}
.nodes{min-width:620px}
td.size{text-align:right!important;white-space:nowrap!important}
code{font:12.5px/1.4 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;overflow-wrap:anywhere}
summary{cursor:pointer;color:var(--muted);padding:4px 0}
footer{max-width:1240px;margin:40px auto 0;padding:16px 24px 40px;color:var(--muted);
font-size:13px}
@media (max-width:860px){.figures{grid-template-columns:minmax(0,1fr)}
figure.half{grid-column:1/-1}.tiles{grid-template-columns:repeat(2,1fr)}}
@media (max-width:520px){main,header.top,nav div,footer{padding-left:14px;padding-right:14px}
header.top{padding-top:22px}h1{font-size:25px}.lead{font-size:16px}
figure{padding:12px 10px 6px}.tile{padding:10px 12px}.tile .value{font-size:22px}
.grid{grid-template-columns:repeat(2,minmax(0,1fr));gap:8px}}
@media print{nav{display:none}figure{break-inside:avoid}}
"""

SCRIPT: Final = """
(() => {
'use strict';
const panels = JSON.parse(document.getElementById('figures').textContent);
const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const isObject = v => v && typeof v === 'object';
let colours = {};
function readColours() {
  for (const name of ['ink', 'muted', 'line', 'band', 'card', 'warn', 'accent'])
    colours['@' + name] = css('--' + name);
}
function resolve(v) {
  if (typeof v === 'string') return v[0] === '@' && colours[v] ? colours[v] : v;
  if (Array.isArray(v)) return v.map(resolve);
  if (!isObject(v) || v.bdata) return v;
  const out = {};
  for (const k of Object.keys(v)) out[k] = resolve(v[k]);
  return out;
}
function themedAxis(a, small) {
  return Object.assign({gridcolor: colours['@line'], zerolinecolor: colours['@band'],
    linecolor: colours['@line'], tickcolor: colours['@line'], automargin: !small, ticks: '',
    zeroline: false}, a, {title: Object.assign({font: {size: 12, color: colours['@muted']},
    standoff: 6}, a.title || {}), tickfont: {size: small ? 10 : 11, color: colours['@muted']}});
}
function themed(panel) {
  const l = resolve(panel.layout), small = panel.height < 200;
  const narrow = window.innerWidth < 520;
  for (const k of Object.keys(l)) if (/^[xy]axis/.test(k)) l[k] = themedAxis(l[k], small);
  if (!l.polar) { l.xaxis = l.xaxis || themedAxis({}, small);
    l.yaxis = l.yaxis || themedAxis({}, small); }
  else {
    l.polar = Object.assign({bgcolor: 'rgba(0,0,0,0)'}, l.polar);
    for (const k of ['angularaxis', 'radialaxis'])
      l.polar[k] = Object.assign({gridcolor: colours['@line'], linecolor: colours['@band'],
        tickfont: {size: 11, color: colours['@muted']}, ticks: ''}, l.polar[k]);
  }
  l.margin = Object.assign({l: narrow ? 42 : 52, r: 14, t: 26, b: 42}, l.margin || {});
  l.legend = Object.assign({font: {size: 12},
    bgcolor: 'rgba(0,0,0,0)'}, l.legend || {});
  l.annotations = (l.annotations || []).map(a =>
    Object.assign({}, a, {font: Object.assign({color: colours['@ink']}, a.font || {})}));
  return Object.assign({showlegend: false, hovermode: 'closest', dragmode: narrow ? false : 'zoom',
    hoverlabel: {bgcolor: colours['@card'], bordercolor: colours['@band'],
      font: {color: colours['@ink'], size: 12}},
    font: {family: getComputedStyle(document.body).fontFamily, size: 12, color: colours['@ink']},
    paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)', height: panel.height}, l);
}
const hidden = new Set();
function traces(panel) {
  return resolve(panel.data).map(t => {
    const bar = t.marker && t.marker.colorbar;
    if (bar) t.marker.colorbar = Object.assign({outlinewidth: 0, ticks: '',
      tickfont: {size: 11, color: colours['@muted']}}, bar, {title: Object.assign(
      {font: {size: 11, color: colours['@muted']}}, bar.title)});
    return hidden.has(t.legendgroup) ? Object.assign(t, {visible: false}) : t;
  });
}
function draw(div) {
  const panel = panels[+div.dataset.panel], small = panel.height < 200;
  const config = {responsive: true, displaylogo: false, staticPlot: small,
    displayModeBar: small ? false : undefined,
    modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d', 'zoomIn2d', 'zoomOut2d']};
  Plotly.react(div, traces(panel), themed(panel), config);
  div.dataset.drawn = '1';
}
const plots = [...document.querySelectorAll('[data-panel]')];
const redraw = () => { readColours(); plots.filter(d => d.dataset.drawn).forEach(draw); };
readColours();
const watch = new IntersectionObserver(entries => {
  for (const e of entries) if (e.isIntersecting) { watch.unobserve(e.target); draw(e.target); }
}, {rootMargin: '600px'});
plots.forEach(d => watch.observe(d));
window.addEventListener('beforeprint', () => plots.forEach(draw));
window.matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redraw);
document.querySelectorAll('nav button').forEach(b => b.addEventListener('click', () => {
  const on = b.getAttribute('aria-pressed') === 'false';
  b.setAttribute('aria-pressed', String(on));
  on ? hidden.delete(b.value) : hidden.add(b.value);
  document.querySelectorAll('[data-satellite]').forEach(d => {
    d.style.display = hidden.has(d.dataset.satellite) ? 'none' : ''; });
  redraw();
}));
})();
"""
