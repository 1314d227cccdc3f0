//! The audit's figures and page; text of a model must not become markup.

use shm_config::message::Preference;
use std::path::Path;
use std::process::Command;

use gate::presentation::{Party, Reply};
use gate::record::Record;
use gate::record::store::{Records, Store, read};
use judge::audit::{Figures, page};

use crate::records::{SHOWING, asking, picture, record};

/// Asked twice, the paths swapped.
fn pair(replies: [Reply; 2], preference: Option<Preference>, safer: Party) -> Record {
    let askings = vec![
        asking(SHOWING, replies[0], 0.85),
        asking(SHOWING.swapped(), replies[1], 0.85),
    ];
    record(askings, preference, safer)
}

fn failed(word: &str) -> Record {
    let mut asking = asking(SHOWING, Reply::First, 0.0);
    (asking.reply, asking.confidence) = (None, None);
    asking.fault = Some(word.into());
    let mut record = record(vec![asking], None, Party::Expert);
    record.fault = word.into();
    record
}

#[test]
fn figures_are_those_counted_by_hand() {
    use Reply::{First, Second, Similar};
    let records = [
        pair([First, Second], Some(Preference::Expert), Party::Expert),
        pair([First, Second], Some(Preference::Expert), Party::Expert),
        pair([Second, First], Some(Preference::Policy), Party::Policy),
        pair([First, Second], Some(Preference::Expert), Party::Policy),
        pair([First, First], Some(Preference::Abstain), Party::Expert),
        pair([First, Similar], Some(Preference::Abstain), Party::Policy),
        pair([Similar, Similar], Some(Preference::Policy), Party::Policy),
        failed("timeout"),
    ];
    let figures = Figures::of(&records);
    assert_eq!((figures.expert, figures.policy, figures.similar), (3, 2, 1));
    assert_eq!((figures.abstained, figures.failed), (2, 1));
    assert_eq!(figures.faults["timeout"], 1);
    assert_eq!(
        figures.agreement.counts,
        [[2, 0, 0, 1, 1], [1, 1, 1, 1, 0]],
        "expert, policy, similar, abstained, failed"
    );
    let right = figures.agreement.of_preferences();
    assert_eq!((right.hits, right.trials), (3, 4), "similar is neither");
    assert_eq!(figures.agreement.of_all().trials, 8);
    // Rows [2, 0] and [1, 1]: agreed 3/4, by chance 2/4 * 3/4 + 2/4 * 1/4 = 1/2.
    assert_eq!(figures.agreement.kappa(), Some(0.5));
    // First place: 3 + 1 of the six clear pairs' eight, both of the fifth, one of
    // the sixth.
    let first = figures.first_place;
    assert_eq!((first.hits, first.trials), (7, 11));
    let flips = figures.flips;
    assert_eq!((flips.consistent, flips.place, flips.mixed), (5, 1, 1));
    // Red was the first one's colour both times, as the places are swapped and the
    // colours with them.
    assert_eq!(figures.hues["red"].hits, 7);
    assert_eq!(figures.hues["cyan"].hits, 4);
    // Confidence 0.85: right were 2 + 2 + 2 + 0 of the clear pairs, one of two in
    // the fifth, none in the sixth.
    let bin = figures.calibration[8];
    assert_eq!((bin.right.hits, bin.right.trials), (7, 11));
    let off = figures.calibration_error.expect("there are some");
    assert!((off - (0.85 - 7.0 / 11.0)).abs() < 1e-9, "{off}");
    assert_eq!(figures.latencies_s.len(), 7, "failures have no latency");
    assert!((figures.cost_usd - 0.015).abs() < 1e-12);
}

#[test]
fn faults_are_counted_by_question_and_add_up_to_those_that_failed() {
    let mut alone = failed("connection_refused");
    alone.askings.push(alone.askings[0].clone());
    alone.fault = "connection_refused".into();
    let mut left = alone.clone();
    for asking in &mut left.askings {
        asking.fault = Some("breaker_open".into());
    }
    left.fault = "breaker_open".into();
    let mut unheard = failed("");
    unheard.askings.clear();
    let figures = Figures::of(&[left.clone(), alone, left, unheard]);
    let faults: Vec<_> = figures.faults.iter().collect();
    let words = ["breaker_open", "connection_refused", "unknown"].map(String::from);
    assert_eq!(faults, [(&words[0], &2), (&words[1], &1), (&words[2], &1)]);
    assert_eq!(figures.faults.values().sum::<usize>(), figures.failed);
}

#[test]
fn similar_is_an_answer_that_is_neither_right_nor_wrong_on_the_page() {
    let similar = pair(
        [Reply::Similar, Reply::Similar],
        Some(Preference::Policy),
        Party::Policy,
    );
    let records = Records {
        folder: "judge".into(),
        questions: vec![similar],
        is_torn: false,
    };
    let html = page(&records, 0, Path::new(".")).html;
    assert!(html.contains("1 question, 2 requests"), "{html}");
    assert!(html.contains("policy 1 (of these similar 1)"), "{html}");
    assert!(html.contains("badge similar"), "{html}");
    assert!(html.contains("right: 0 of 0 preferences, in 1 question "));
    assert!(!html.contains("✓ right") && !html.contains("✗ wrong"));
    assert!(html.contains("(none)") && !html.contains("0.0 to 100.0 %"));
    assert!(html.contains("No reply preferred a path."), "and no chart");
}

#[test]
fn text_of_a_model_is_escaped() {
    let evil = "</pre><script>alert(1)</script><img src=x onerror=alert(2)>\"'";
    let mut record = pair(
        [Reply::First, Reply::Second],
        Some(Preference::Expert),
        Party::Expert,
    );
    record.fault = evil.into();
    record.model = evil.into();
    record.preset = evil.into();
    for asking in &mut record.askings {
        asking.said = evil.into();
        asking.user = evil.into();
        asking.system = evil.into();
        asking.picture = "../../etc/passwd".into();
    }
    let mut fault = failed(evil);
    fault.askings[0].picture = "pictures/x.png\" onload=\"alert(3)".into();
    let records = Records {
        folder: evil.into(),
        questions: vec![record, fault],
        is_torn: true,
    };
    let html = page(&records, 10, Path::new(".")).html;
    assert!(
        !html.contains("<script") && !html.contains("<img"),
        "{html}"
    );
    assert!(!html.contains("onload=\"alert"));
    assert!(html.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
    assert!(!html.contains("passwd"));
    assert!(html.contains("default-src 'none'"));
}

#[test]
fn pictures_are_embedded_up_to_the_limit_and_linked_beyond() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 20).expect("opens");
    for safer in [Party::Expert, Party::Expert, Party::Policy] {
        let record = pair(
            [Reply::First, Reply::Second],
            Some(Preference::Expert),
            safer,
        );
        store.begin(record, &[picture(1), picture(2)]);
    }
    store.finish();
    let records = read(folder.path()).expect("reads");
    let html = page(&records, 2, Path::new("judge")).html;
    let embedded = html.matches("src=\"data:image/png;base64,").count();
    assert_eq!(
        (embedded, html.matches("href=\"judge/pictures/").count()),
        (2, 4)
    );
    // The wrong answer is what one looks for: its pictures come first.
    assert!(!html.contains("href=\"judge/pictures/000003-a.png"));
    std::fs::remove_dir_all(folder.path().join("pictures")).expect("removed");
    let html = page(&records, 2, Path::new("judge")).html;
    assert_eq!(html.matches("picture is missing").count(), 6);
}

#[test]
fn a_page_elsewhere_has_its_pictures_beside_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let judge = folder.path().join("run/judge");
    let mut store = Store::open(&judge, 1 << 20).expect("opens");
    let record = pair(
        [Reply::First, Reply::Second],
        Some(Preference::Expert),
        Party::Expert,
    );
    store.begin(record, &[picture(1), picture(2)]);
    store.finish();
    let out = folder.path().join("elsewhere/page.html");
    std::fs::create_dir(folder.path().join("elsewhere")).expect("a folder");
    let audit = |out: &Path| {
        let output = Command::new(env!("CARGO_BIN_EXE_vlaps-judge"))
            .args(["audit", "--pictures", "1", "--out"])
            .args([out, judge.as_path()])
            .output()
            .expect("it runs");
        assert!(output.status.success(), "{output:?}");
        std::fs::read_to_string(out).expect("a page")
    };
    let html = audit(&out);
    let link = "page-files/pictures/000001-b.png";
    assert!(html.contains(&format!("href=\"{link}\"")), "{html}");
    let beside = out.with_file_name(link);
    let kept = judge.join("pictures/000001-b.png");
    let read = |path: &Path| std::fs::read(path).expect("a picture");
    assert_eq!(read(&beside), read(&kept));
    // With the records nothing needs to be copied.
    let html = audit(&folder.path().join("run/page.html"));
    assert!(
        html.contains("href=\"judge/pictures/000001-b.png\""),
        "{html}"
    );
    assert!(!folder.path().join("run/page-files").exists());
}
