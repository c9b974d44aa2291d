//! What every page has: head, style, and small parts.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use plotters::style::RGBColor;

const STYLE: &str = "\
body { font: 14px/1.45 sans-serif; color: #222; max-width: 980px; margin: 24px auto; padding: 0 12px }
h1 { font-size: 24px; margin: 0 } h2 { font-size: 18px; margin: 28px 0 8px } h3 { font-size: 14px; margin: 10px 0 0 }
p { margin: 4px 0 8px } .note { color: #666 }
.failure { color: #b02020; font-weight: bold }
table { border-collapse: collapse; margin: 4px 0 } td, th { padding: 2px 14px 2px 0; text-align: left; vertical-align: top }
tr { border-bottom: 1px solid #e6e6e6 } td.number, th.number { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums }
td.meaning { color: #666 } code { font-size: 13px; overflow-wrap: anywhere }
svg, img { max-width: 100%; height: auto; display: block }
.row { display: flex; gap: 8px } .row > * { flex: 1; min-width: 0; margin: 0 }
.legend > span { margin-right: 16px; white-space: nowrap }
.swatch { display: inline-block; width: 12px; height: 12px; margin-right: 5px; vertical-align: -1px }
figure, .plot { break-inside: avoid } figcaption { color: #666 }
@media print { body { margin: 0; max-width: none } * { print-color-adjust: exact; -webkit-print-color-adjust: exact } }
";

/// A page.
pub fn page(title: &str, content: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body { (content) }
        }
    };
    page.into_string()
}

/// What colours stand for.
pub fn legend<'a>(entries: impl IntoIterator<Item = (RGBColor, &'a str)>) -> Markup {
    html! {
        p.legend {
            @for (RGBColor(r, g, b), text) in entries {
                span { span.swatch style=(format!("background:#{r:02x}{g:02x}{b:02x}")) {} (text) }
            }
        }
    }
}

/// A number for people: four digits, or all of a whole or large one.
pub fn number(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e15 {
        return format!("{value:.0}");
    }
    let magnitude = value.abs().log10().floor();
    if (-6.0..15.0).contains(&magnitude) {
        format!("{value:.*}", (3.0 - magnitude).max(0.0) as usize)
    } else {
        format!("{value:.3e}")
    }
}
