#include "common/html_page.h"

#include "absl/strings/str_cat.h"
#include "common/svg_elements.h"

namespace robostress {
namespace {

constexpr char kStyle[] = R"css(
:root{color-scheme:light dark;--ink:#1f2937;--muted:#6b7280;--line:#e5e7eb;--soft:#f8fafc;--accent:#0072b2;--paper:#fff;--rule:#cbd5e1;--warn:#fff7ed}
*{box-sizing:border-box}
body{margin:0;color:var(--ink);background:var(--paper);font:15px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,Helvetica,Arial,sans-serif}
header{background:#0f172a;color:#f8fafc;padding:34px 0 30px}
header p{margin:6px 0 0;color:#cbd5e1}
.wrap{max-width:1120px;margin:0 auto;padding:0 28px}
h1{font-size:27px;line-height:1.25;margin:0;font-weight:650}
h2{font-size:20px;margin:44px 0 8px;padding-top:6px;font-weight:650}
h3{font-size:15px;margin:26px 0 6px;font-weight:650}
nav{border-bottom:1px solid var(--line);background:var(--soft)}
nav a{display:inline-block;padding:10px 18px 10px 0;color:var(--ink);text-decoration:none;font-size:14px}
nav a:hover{color:var(--accent)}
.lead{font-size:17px;max-width:86ch;margin:24px 0 4px}
.note{color:var(--muted);font-size:13.5px;max-width:100ch;margin:8px 0}
.warn{border-left:4px solid #d55e00;background:var(--warn);padding:9px 14px;margin:14px 0;max-width:100ch}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(168px,1fr));gap:12px;margin:22px 0 8px}
.tile{border:1px solid var(--line);border-radius:8px;padding:12px 15px;background:var(--paper)}
.tile b{display:block;white-space:nowrap;font-size:22px;line-height:1.3;font-weight:650;font-variant-numeric:tabular-nums}
.tile span{color:var(--muted);font-size:12.5px;display:block}
.scroll{overflow-x:auto}
table{border-collapse:collapse;margin:10px 0;font-size:13.5px;font-variant-numeric:tabular-nums}
th,td{padding:6px 12px;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap;vertical-align:top}
th{font-weight:600;border-bottom:2px solid var(--rule);vertical-align:bottom}
th:first-child,td:first-child{text-align:left;padding-left:2px}
tr.avg td{border-top:2px solid var(--rule);font-weight:600}
td small,th small{color:var(--muted);font-weight:400;font-size:12px}
td .ci{color:var(--muted);font-weight:400;font-size:12px;display:block;line-height:1.3}
.dot{display:inline-block;width:9px;height:9px;border-radius:50%;margin-right:6px}
.tag{background:#fef3c7;color:#92400e;border-radius:4px;padding:1px 6px;font-size:12px;font-weight:600}
.paper{color:var(--muted)}
svg{max-width:100%;height:auto}
.panels{display:flex;flex-wrap:wrap;gap:8px 10px}
.videos{display:grid;grid-template-columns:repeat(auto-fill,minmax(500px,1fr));gap:18px}
.pair{border:1px solid var(--line);border-radius:8px;padding:12px 14px}
.pair .row{display:grid;grid-template-columns:repeat(auto-fill,minmax(210px,1fr));gap:10px}
.pair figure{margin:0}
.pair img{width:100%;border-radius:4px;display:block}
figcaption{font-size:12.5px;color:var(--muted);margin-top:4px}
pre{background:var(--soft);border:1px solid var(--line);border-radius:6px;padding:12px 14px;overflow-x:auto;font-size:12.5px;line-height:1.45}
details{margin:8px 0}summary{cursor:pointer;color:var(--accent)}
li{margin:5px 0;max-width:100ch}
footer{color:var(--muted);font-size:13px;border-top:1px solid var(--line);margin-top:50px;padding:18px 0 34px}
@media print{nav{display:none}header{background:#fff;color:#000}header p{color:#444}h2,h3{break-after:avoid}svg,tr,.tile{break-inside:avoid}}
@media screen and (prefers-color-scheme:dark){
:root{--ink:#e5e7eb;--muted:#9ca3af;--line:#2b3546;--soft:#131c2e;--accent:#56b4e9;--paper:#0b1220;--rule:#475569;--warn:#2a1d12}
svg [fill="#ffffff"]{fill:var(--paper)}svg [stroke="#ffffff"]{stroke:var(--paper)}
svg [fill="#1f2937"]{fill:var(--ink)}svg [stroke="#1f2937"]{stroke:var(--ink)}
svg [fill="#6b7280"]{fill:var(--muted)}svg [stroke="#6b7280"]{stroke:var(--muted)}
svg [stroke="#e5e7eb"]{stroke:var(--line)}
svg [fill="#0072b2"]{fill:#56b4e9}svg [stroke="#0072b2"]{stroke:#56b4e9}
}
)css";

}  // namespace

std::string PageHead(const std::string& title) {
  return absl::StrCat(
      "<!doctype html>\n<html lang=en><head><meta charset=utf-8><meta name=viewport "
      "content=\"width=device-width,initial-scale=1\"><title>",
      EscapeXml(title), "</title><style>", kStyle, "</style></head><body>\n");
}

}  // namespace robostress
