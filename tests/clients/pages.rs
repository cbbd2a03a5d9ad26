//! What README.md and the pages of `deploy/docs` show works as written: every block is run, written to a file that a later
//! one uses, or equal to a file that has a test of its own; every link leads somewhere.
//!
//! The words behind a fence say how: `file=PATH` writes the block there; `is=PATH` says that it is that file; `by=PATH` names
//! the test that runs it; `needs=a,b` names programs, or the folder of model files (`data`), without which it is skipped. `sh` runs, `python` runs in the virtual
//! environment that the page made, `text` is what the commands before it write, `…` standing for anything.

use crate::support::book;
use crate::support::process::{root, show};
pub(super) mod checkout;

use checkout::{Checkout, Played};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Every page for users that has no test of its own.
const PAGES: [&str; 34] = [
    "README.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "deploy/README.md",
    "deploy/docs/agents.md",
    "deploy/docs/animation.md",
    "deploy/docs/architecture.md",
    "deploy/docs/batches.md",
    "deploy/docs/command-line.md",
    "deploy/docs/concepts.md",
    "deploy/docs/contact.md",
    "deploy/docs/durability.md",
    "deploy/docs/formats.md",
    "deploy/docs/frame.md",
    "deploy/docs/glossary.md",
    "deploy/docs/guides.md",
    "deploy/docs/quality.md",
    "deploy/docs/security.md",
    "deploy/docs/README.md",
    "deploy/docs/speed.md",
    "deploy/docs/tour.md",
    "deploy/docs/cookbook-assets.md",
    "deploy/docs/cookbook-ci.md",
    "deploy/docs/cookbook-motion.md",
    "deploy/docs/cookbook-web.md",
    "deploy/docs/limits.md",
    "deploy/docs/nodes.md",
    "deploy/docs/notebook.md",
    "deploy/docs/other-languages.md",
    "deploy/docs/troubleshooting.md",
    "deploy/docs/wrap.md",
    "proto/clients/comfyui/README.md",
    "proto/clients/cpp/README.md",
    "proto/clients/csharp/README.md",
];

fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Whether a test quotes how a block of commands begins, so that it can find and run it, or names the scripts that it runs.
fn is_run_by(commands: &str, test: &str) -> bool {
    let words: Vec<&str> = commands.split_whitespace().collect();
    let scripts = words
        .iter()
        .filter_map(|word| word.rsplit_once('/'))
        .map(|(_, name)| name)
        .filter(|name| name.contains('.'));
    let mut scripts = scripts.peekable();
    test.contains(&words[..words.len().min(3)].join(" "))
        || scripts.peek().is_some() && scripts.all(|name| test.contains(name))
}

/// Plays a page from its first block to its last.
fn play(page: &str) -> Checkout {
    let mut checkout = Checkout::new();
    if !checkout::has("bash") {
        show(&format!("SKIPPED: {page}: there is no bash"));
        return checkout;
    }
    let mut was_skipped = false;
    for block in book::blocks(&read(page)) {
        block.check(page);
        if let Some(file) = block.word("is") {
            assert!(
                read(file).trim_end() == block.text.trim_end(),
                "{page}:{}: this is not {file}",
                block.line
            );
            continue;
        }
        if let Some(test) = block.word("by") {
            let runs = is_run_by(&block.text, &read(test));
            assert!(runs, "{page}:{}: {test} does not run this", block.line);
            continue;
        }
        // What a block writes that was skipped stands on the page, and nowhere else.
        if was_skipped && block.language == "text" && block.word("file").is_none() {
            continue;
        }
        let played = checkout.play(&block);
        was_skipped = matches!(played, Played::Skipped(_));
        if let Played::Skipped(reason) = played {
            show(&format!("SKIPPED: {page}:{}: {reason}", block.line));
            // What follows may build on it; a missing compiler stops no one else.
            if block.word("needs").is_none() || checkout::is_offline(&reason) {
                break;
            }
        }
    }
    checkout
}

#[test]
fn readme() {
    play("README.md");
}

#[test]
fn tour() {
    play("deploy/docs/tour.md");
}

#[test]
fn command_line() {
    let checkout = play("deploy/docs/command-line.md");
    if checkout.path("target/turned.glb").exists() {
        assert!(checkout.path("target/turned.png").exists(), "the picture is drawn");
    }
}

#[test]
fn agents() {
    let checkout = play("deploy/docs/agents.md");
    if checkout.path("target/agent-4-pose.png").exists() {
        assert!(
            checkout.path("target/reaching.glb").exists(),
            "the posed figure is written"
        );
    }
}

#[test]
fn notebook() {
    play("deploy/docs/notebook.md");
}

#[test]
fn wrap() {
    let checkout = play("deploy/docs/wrap.md");
    if checkout.path("target/led.glb").exists() {
        shows_what_it_draws(&checkout, &[("wrapped", "wrapped")]);
    }
}

#[test]
fn contact() {
    play("deploy/docs/contact.md");
}

#[test]
fn guides() {
    let checkout = play("deploy/docs/guides.md");
    if checkout.path("target/creature.glb").exists() {
        for picture in ["target/arc.png", "target/lattice.png"] {
            assert!(checkout.path(picture).exists(), "{picture} is drawn");
        }
    }
}

#[test]
fn animation() {
    let checkout = play("deploy/docs/animation.md");
    if checkout.path("target/nod").exists() {
        for picture in ["target/walk.png", "target/nod.png"] {
            assert!(checkout.path(picture).exists(), "{picture} is drawn");
        }
    }
}

#[test]
fn running_the_server() {
    play("deploy/README.md");
}

#[test]
fn security() {
    play("deploy/docs/security.md");
}

#[test]
fn nodes() {
    play("deploy/docs/nodes.md");
}

#[test]
fn batches() {
    let checkout = play("deploy/docs/batches.md");
    assert!(checkout.path("target/batch_jobs.py").exists() || !checkout::has("bash"));
}

#[test]
fn durability() {
    let checkout = play("deploy/docs/durability.md");
    if checkout.path("target/backups").exists() {
        assert!(checkout.path("target/restored.glb").exists(), "the model is written");
    }
}

/// The pictures of a page are what its commands draw: of each, the name in `pictures/` and the one that is drawn.
fn shows_what_it_draws(checkout: &Checkout, pictures: &[(&str, &str)]) {
    for (shown, drawn) in pictures {
        let shown = format!("deploy/docs/pictures/{shown}.png");
        let drawn = checkout.path(&format!("target/{drawn}.png"));
        assert_eq!(
            size_of_png(&drawn),
            size_of_png(&root().join(&shown)),
            "{shown} is what the page's command draws"
        );
    }
}

#[test]
fn every_cookbook_opens_with_a_picture() {
    for page in PAGES.iter().filter(|page| page.contains("cookbook")) {
        let text = read(page);
        let first = text.lines().skip(1).find(|line| !line.is_empty()).unwrap_or_default();
        let picture = first
            .strip_prefix("![")
            .and_then(|rest| rest.split_once("](pictures/")?.1.strip_suffix(')'));
        assert!(picture.is_some_and(|name| name.ends_with(".png")), "{page}: {first}");
    }
}

#[test]
fn cookbook_for_assets() {
    let checkout = play("deploy/docs/cookbook-assets.md");
    if checkout.path("target/turned-beside.png").exists() {
        let rods = ["rod", "rod-turned", "rod-coarse"].map(|name| (name, name));
        shows_what_it_draws(&checkout, &rods);
        shows_what_it_draws(&checkout, &[("turned", "turned-beside")]);
    }
}

#[test]
fn cookbook_for_ci() {
    let checkout = play("deploy/docs/cookbook-ci.md");
    if !checkout.path("target/bent.obj").exists() {
        return;
    }
    assert!(checkout.path("target/round.png").exists(), "it is drawn");
    shows_what_it_draws(&checkout, &[("bent", "bent")]);
}

#[test]
fn cookbook_for_motion() {
    let checkout = play("deploy/docs/cookbook-motion.md");
    if !checkout.path("target/creature.glb").exists() {
        return;
    }
    let drawn = [
        ("boxer-sheet", "boxer"),
        ("cutaway", "cutaway"),
        ("ballet", "ballet"),
        ("twist", "twist"),
        ("walk-beside", "walk-beside"),
    ];
    shows_what_it_draws(&checkout, &drawn);
}

/// Pixels across and down.
fn size_of_png(path: &Path) -> [u32; 2] {
    let bytes = fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes")))
}

#[test]
#[ignore = "takes minutes; .ci/run runs it"]
fn cookbook_for_the_web() {
    let _held = super::hold_typescript_package();
    let checkout = play("deploy/docs/cookbook-web.md");
    let page = checkout.path("target/page/dist");
    let packages = root().join("tests/clients/viewer/node_modules");
    if !page.is_dir() {
        return;
    }
    if !packages.is_dir() {
        let mut npm = Command::new("npm");
        npm.args(["ci", "--no-audit", "--no-fund", "--silent"])
            .current_dir(root().join("tests/clients/viewer"));
        if !npm.status().is_ok_and(|status| status.success()) {
            return show("SKIPPED: the cookbook's page in a browser: playwright-core cannot be fetched");
        }
    }
    let arrows = checkout.path("target/arrows.png");
    for (driver, page) in [
        ("page.mjs", page),
        ("grip.mjs", checkout.path("target/examples/dragger/dist")),
        ("player.mjs", checkout.path("target/examples/player/dist")),
        ("model.mjs", checkout.path("target/examples/model/dist")),
    ] {
        let driver = root().join("tests/clients/viewer").join(driver);
        let mut node = Command::new("node");
        node.arg(driver).arg(&page).arg(&arrows);
        // The examples are files of the checkout, in which the usual address stands.
        node.envs(checkout.server().map(|server| ("PLIANT_SERVER", server)));
        let done = node.output().expect("node runs");
        let said = [done.stdout, done.stderr]
            .map(|b| String::from_utf8_lossy(&b).into_owned())
            .concat();
        assert!(done.status.success(), "{said}");
        show(said.trim());
    }
    if arrows.exists() {
        shows_what_it_draws(&checkout, &[("arrows", "arrows")]);
    }
}

#[test]
fn other_languages() {
    play("deploy/docs/other-languages.md");
    play("proto/clients/cpp/README.md");
    let checkout = play("proto/clients/csharp/README.md");
    // What the pages and the library name is at least there in the generated messages.
    if let Ok(made) = fs::read_to_string(checkout.path("target/csharp-messages/Pliant.cs")) {
        for name in ["namespace Pliant.V1", "class SessionRequest", "string SessionId"] {
            assert!(made.contains(name), "{name}");
        }
    }
}

#[test]
fn limits_and_troubles() {
    play("deploy/docs/limits.md");
    play("deploy/docs/troubleshooting.md");
}

#[test]
fn every_place_they_name_exists() {
    let tops = ["src/", "tests/", "proto/", "deploy/", "loadtest/", ".ci/"];
    let mut missing = Vec::new();
    for page in PAGES {
        let (links, quoted) = book::places(&read(page));
        let beside = root().join(page);
        let beside = beside.parent().expect("a folder");
        missing.extend(
            links
                .into_iter()
                .filter(|l| !beside.join(l).exists())
                .map(|l| (page, l)),
        );
        let files = quoted
            .into_iter()
            .filter(|q| tops.iter().any(|top| q.starts_with(top)) && !q.contains(char::is_whitespace));
        missing.extend(files.filter(|f| !root().join(f).exists()).map(|f| (page, f)));
    }
    assert!(missing.is_empty(), "pages name what is not there: {missing:?}");
}

#[test]
fn no_page_is_left_out() {
    for entry in fs::read_dir(root().join("deploy/docs")).expect("the pages") {
        let entry = entry.expect("a page");
        if entry.path().is_dir() {
            continue;
        }
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let page = format!("deploy/docs/{name}");
        assert!(PAGES.contains(&page.as_str()), "no test plays {page}");
        let index = "deploy/docs/README.md";
        let linked = page == index || read(index).contains(&format!("]({name})"));
        assert!(linked, "{index} does not link to {page}");
    }
}
