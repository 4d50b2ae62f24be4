"""The style of the report's page: one sheet, light and dark, narrow and printed, with nothing from outside."""

STYLE = """
:root{color-scheme:light dark;--bg:#f7f7f5;--card:#fff;--ink:#1a1d21;--muted:#5f6670;--line:#e2e3e6;
--accent:#0a66c2;--second:#a35200;--good:#177245;--fair:#9a5b00;--poor:#c0272d;--tint-good:#e3f4ea;--tint-fair:#fdf0d9;
--tint-poor:#fde5e4}
@media screen and (prefers-color-scheme:dark){:root{--bg:#121416;--card:#1a1d20;--ink:#eceef0;--muted:#9aa3ad;--line:#2c3136;
--accent:#58a9ff;--second:#ffab5e;--good:#46cf8b;--fair:#ffbf47;--poor:#ff7570;--tint-good:#11291d;--tint-fair:#2e2410;
--tint-poor:#351817}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--bg);color:var(--ink);font:15px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;
font-variant-numeric:tabular-nums}
main{max-width:1080px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:17px;font-weight:600;margin:0;letter-spacing:-.005em}
h2{font-size:20px;margin:0 0 4px;letter-spacing:-.01em;line-height:1.25}
h3{font-size:14px;margin:18px 0 6px}
p{margin:6px 0 12px;max-width:74ch}
a{color:var(--accent)}
header{display:flex;flex-wrap:wrap;gap:2px 16px;align-items:baseline;margin-bottom:14px}
header span,.muted,figcaption,.lead{color:var(--muted)}
section{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:20px 22px;margin:16px 0}
nav{display:flex;flex-wrap:wrap;gap:4px 16px;font-size:13.5px;margin:14px 2px}
nav a{text-decoration:none}nav a:hover{text-decoration:underline}
.verdict{border-left:6px solid var(--muted)}
.verdict.good{border-left-color:var(--good);background:var(--tint-good)}
.verdict.fair{border-left-color:var(--fair);background:var(--tint-fair)}
.verdict.poor{border-left-color:var(--poor);background:var(--tint-poor)}
.verdict h2{font-size:27px;letter-spacing:-.02em}
.verdict p{margin:8px 0 0}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(205px,1fr));gap:14px 26px;margin-top:10px}
.card b{display:block;font-size:25px;font-weight:650;letter-spacing:-.02em;line-height:1.2}
.card b small{font-size:14px;font-weight:500;color:var(--muted);letter-spacing:0}
.card .muted{font-size:13px;display:block}
.scroll{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-size:14px}
th{font-weight:600;color:var(--muted);font-size:12.5px;vertical-align:bottom}
th,td{text-align:right;padding:6px 10px;border-bottom:1px solid var(--line)}
th:first-child,td:first-child,td.text,th.text{text-align:left;padding-left:0}
td.text,th.text{padding-left:10px}
tr:last-child td{border-bottom:0}
td{white-space:nowrap}td.text,td:first-child{white-space:normal}.tight{width:auto;min-width:min(100%,460px)}
tr.chosen td{font-weight:650;background:color-mix(in srgb,var(--accent) 9%,transparent)}
tr.chosen td:first-child{padding-left:8px}
.do{display:block;color:var(--muted);font-size:13px;max-width:64ch;white-space:normal}
.tag{display:inline-block;border-radius:99px;padding:0 9px;font-size:12.5px;font-weight:600;line-height:20px;
white-space:nowrap}
.tag.good{color:var(--good);background:var(--tint-good)}.tag.fair{color:var(--fair);background:var(--tint-fair)}
.tag.poor{color:var(--poor);background:var(--tint-poor)}
.two{display:grid;grid-template-columns:repeat(auto-fit,minmax(310px,1fr));gap:18px 28px;align-items:start}
svg{display:block;max-width:100%;height:auto}
.chart{width:100%;max-width:520px}.map{width:100%;max-width:600px;max-height:540px}.range{width:166px;min-width:120px}
.limits{width:206px;margin:6px 0 4px;overflow:visible}
svg text{font:12px system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;fill:var(--ink)}
svg .tick{fill:var(--muted);font-size:11px}svg .label{fill:var(--muted);font-size:12px}
svg .cell{font-size:13px;font-weight:600}
.grid{stroke:var(--line);stroke-width:1}.one{fill:none;stroke:var(--ink);stroke-width:1;stroke-dasharray:2 3}
.right{fill:var(--good);fill-opacity:.13}
.line-first,.line-second,.law{fill:none;stroke-width:2;stroke-linejoin:round}
.line-first{stroke:var(--accent)}.line-second{stroke:var(--second);stroke-dasharray:5 4}
.law{stroke:var(--muted);stroke-width:1.5;stroke-dasharray:2 4}
.dot-first{fill:var(--accent)}.dot-second{fill:var(--second)}
.fill-first{fill:var(--accent);fill-opacity:.16}.fill-second{fill:var(--second);fill-opacity:.14}
.draw{fill:var(--accent);fill-opacity:.4}.now{stroke:var(--muted);stroke-dasharray:3 3}
.expected{fill:var(--card);stroke:var(--accent);stroke-width:2}
.bar{fill:var(--good);fill-opacity:.45}.bar.off{fill:var(--fair);fill-opacity:.45}.bar.far{fill:var(--poor);fill-opacity:.5}
.zone-good{fill:var(--good);fill-opacity:.4}.zone-fair{fill:var(--fair);fill-opacity:.4}
.zone-poor{fill:var(--poor);fill-opacity:.4}
.whisker{fill:var(--ink)}.marker{fill:var(--ink);stroke:var(--card);stroke-width:2}
.ground{fill:var(--ink);fill-opacity:.045}
.petal{fill:var(--accent)}.petal.none{fill:var(--card);stroke:var(--line);stroke-width:.6;fill-opacity:1}
.next{fill:none;stroke:var(--second);stroke-width:2;stroke-dasharray:6 4}
.next-mark{fill:var(--second)}svg .next-text{font-weight:700;font-size:14px;fill:var(--card)}
.heat{fill:var(--poor);shape-rendering:crispEdges}.arrow{stroke:var(--ink);stroke-width:1.5;stroke-linecap:round}
.tail{fill:var(--ink)}
.key{display:flex;flex-wrap:wrap;gap:4px 18px;font-size:13px;color:var(--muted);margin:8px 0 0;padding:0;list-style:none}
.key i{display:inline-block;width:18px;height:10px;border-radius:2px;margin-right:6px;vertical-align:baseline}
.presses{display:grid;grid-template-columns:repeat(auto-fill,minmax(116px,1fr));gap:12px 10px;margin-top:12px}
.press{position:relative;cursor:zoom-in;font-size:12px;line-height:1.35}
.press input{position:absolute;opacity:0;width:1px;height:1px}
.press .view{display:block}
.press svg{width:100%;border-radius:5px;background:#000}
.press .name{display:block;font-weight:600;overflow-wrap:anywhere;margin-top:3px}
.press .more{display:none}
.press.no .name,.press .why{color:var(--poor)}.press.worse .figures{color:var(--fair);font-weight:600}
.press input:focus-visible+.view{outline:3px solid var(--accent);outline-offset:2px;border-radius:5px}
.press input:checked+.view{position:fixed;inset:0;z-index:9;background:var(--bg);display:flex;flex-direction:column;
align-items:center;justify-content:center;padding:20px;cursor:zoom-out;font-size:15px;line-height:1.5;text-align:center}
.press input:checked+.view svg{width:min(92vw,calc(78vh*var(--aspect)))}
.press input:checked+.view .more{display:block;color:var(--muted)}
.circle-under,.circle,.center{fill:none;vector-effect:non-scaling-stroke}
.circle-under{stroke:#000;stroke-opacity:.6;stroke-width:3.5px}.circle{stroke:#5dff8f;stroke-width:1.7px}
.no .circle{stroke:#ff7a6e}
.center{stroke:#fff;stroke-width:1px}
.caps{display:grid;grid-template-columns:repeat(auto-fill,minmax(64px,1fr));gap:10px 8px;margin-top:10px}
.caps figure{margin:0;text-align:center}
.caps img{width:56px;height:56px;object-fit:contain;background:color-mix(in srgb,var(--ink) 5%,transparent);
border-radius:50%}
.caps figcaption{font-size:10.5px;line-height:1.25;overflow-wrap:anywhere}
dl{display:grid;grid-template-columns:max-content 1fr;gap:5px 20px;margin:10px 0 0;font-size:14px}
dt{color:var(--muted)}dd{margin:0;overflow-wrap:anywhere}
code{font:12.5px ui-monospace,SFMono-Regular,Menlo,Consolas,monospace}
.photo{width:100%;max-width:340px;border-radius:6px;display:block}
ul.notes{padding-left:18px;margin:8px 0;max-width:80ch}
@media (max-width:560px){.limit{display:none}th,td{padding:6px 6px}main{padding:16px 12px 40px}
section{padding:16px 14px;border-radius:10px}
.verdict h2{font-size:22px}
dl{grid-template-columns:1fr;gap:0}dd{margin-bottom:8px}.presses{grid-template-columns:repeat(auto-fill,minmax(104px,1fr))}}
@media print{:root{--bg:#fff;--card:#fff;--ink:#000;--muted:#444;--line:#bbb}body{font-size:11px}
main{max-width:none;padding:0}
nav{display:none}.verdict h2{font-size:20px}.verdict{padding:10px 14px}.card b{font-size:18px}
section{border:0;border-top:1px solid #bbb;border-radius:0;padding:10px 0;margin:8px 0}
figure,tr,.press,svg,.card{break-inside:avoid}h2,h3{break-after:avoid}.presses{grid-template-columns:repeat(7,1fr)}
.caps{grid-template-columns:repeat(10,1fr)}.cards{grid-template-columns:repeat(4,1fr);gap:10px}.limits{width:150px}
table,.key,dl,.card .muted,.do,.press,th{font-size:10.5px}th,td{padding:3px 6px}h2{font-size:15px}h3{font-size:12px}
*{print-color-adjust:exact;-webkit-print-color-adjust:exact}}
"""
