//! The frame of the page: its style, light and dark, and what stands around the cases.

/// All of the page's style. It names no other file.
pub(super) const STYLE: &str = "
:root { color-scheme: light dark; --ink: #1d2430; --soft: #5a6472; --ground: #ffffff; --card: #f5f6f8; --line: #d7dce2;
  --passed: #1a7f37; --failed: #c02626; --skipped: #8a6100; --blessed: #3557c9; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ee; --soft: #9aa4b2; --ground: #14171c; --card: #1d2127; --line: #333a44;
  --passed: #4cc46a; --failed: #ff7b72; --skipped: #e0b04c; --blessed: #8ea8ff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 82rem; padding: 1.5rem 1.25rem 4rem; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.5rem; margin: 0 0 .25rem; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 0; overflow-wrap: anywhere; }
p { margin: .25rem 0; overflow-wrap: anywhere; }
a { color: inherit; }
.soft { color: var(--soft); }
.counts { display: flex; flex-wrap: wrap; gap: .5rem 1.5rem; margin: .75rem 0 1.5rem; font-weight: 600; }
.passed { color: var(--passed); } .failed { color: var(--failed); } .skipped { color: var(--skipped); }
.blessed { color: var(--blessed); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .3rem .75rem .3rem 0; border-bottom: 1px solid var(--line); vertical-align: top;
  overflow-wrap: anywhere; }
th { color: var(--soft); font-weight: 500; }
td.number, .cases td:nth-child(-n+2), .cases th { white-space: nowrap; }
section { border: 1px solid var(--line); border-left: 4px solid currentColor; border-radius: 6px; margin: 1.25rem 0;
  padding: 1rem 1.25rem; }
section > * { color: var(--ink); }
section > header { display: flex; flex-wrap: wrap; gap: .25rem .75rem; align-items: baseline; margin-bottom: .5rem; }
.word { font-weight: 700; text-transform: uppercase; font-size: .8rem; letter-spacing: .05em; }
ul.reasons { margin: .5rem 0; padding-left: 1.2rem; }
code { font: .92em ui-monospace, monospace; background: var(--card); padding: .05em .35em; border-radius: 4px;
  overflow-wrap: anywhere; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(21rem, 100%), 1fr)); gap: 1rem; margin: 1rem 0; }
figure { margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: 6px; overflow: hidden; }
figure img { display: block; width: 100%; height: auto; }
figcaption { padding: .4rem .7rem; font-size: .85rem; color: var(--soft); }
figcaption b { color: var(--ink); }
details { margin-top: .5rem; } summary { cursor: pointer; color: var(--soft); }
tr.over td { color: var(--failed); font-weight: 600; }
@media print { details > * { display: block; } section { break-inside: avoid; } }
";

/// The page around `body`, both already escaped.
pub(super) fn html_page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
    )
}
