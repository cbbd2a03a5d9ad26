//! What is refused of an animation: clips, rigs, values, sizes.

use super::*;
use tonic::Code;
use tonic_types::StatusExt as _;

/// Asks over HTTP and expects a refusal: status, detail and field.
async fn refused(server: &Server, id: &str, options: &Value, clip: Option<String>) -> (u16, String, String) {
    let answer = post_animation(server, id, "*/*", animation_form(options, clip)).await;
    let status = answer.status().as_u16();
    let problem: Value = answer.json().await.expect("a problem document");
    let field = problem["errors"][0]["field"].as_str().unwrap_or_default();
    (status, text(&problem["detail"]), field.to_owned())
}

/// What is damaged | a text of the clip | what comes in its place | words of the refusal. ROW is the first row, REST the row without
/// its first digit, SHORT the row without its last number, LINE the row's place, HERE a place, and `\n` the end of a line.
const DAMAGED_CLIPS: &str = r#"
an open brace      | }\n}\n}\nMOTION | }\n}\nMOTION | HERE
a short row        | ROW              | SHORT         | LINE
a long row         | ROW              | ROW 5         | LINE
NaN                | ROW              | NaNREST       | LINE
a decimal comma    | ROW              | 0,5REST       | LINE
no frames          | Frames: 3        | Frames: 0     | HERE
too few rows       | Frames: 3        | Frames: 9     | 9
countless frames   | Frames: 3        | Frames: 1000000000000 | 1000000
no time            | Frame Time: 0.05 | Frame Time: 0 | HERE
an unknown channel | Xposition        | Wposition     | Wposition
"#;

#[tokio::test(flavor = "multi_thread")]
async fn damaged_clips_are_refused_with_the_line() {
    let (server, id) = opened_bar().await;
    let good = bending_clip(3);
    let first_row = good.lines().position(|l| l.starts_with("Frame Time")).expect("a line") + 2;
    let row = good.lines().nth(first_row - 1).expect("a row");
    let short = row.rsplit_once(' ').expect("numbers").0;
    let fill = |cell: &str| {
        let cell = cell.replace(r"\n", "\n").replace("ROW", row).replace("REST", &row[1..]);
        cell.replace("SHORT", short)
            .replace("LINE", &format!("line {first_row}: "))
            .replace("HERE", "line ")
    };
    let damaged = rows(DAMAGED_CLIPS).map(|[what, place, by, reply]| {
        let clip = good.replacen(&fill(place), &fill(by), 1);
        assert_ne!(clip, good, "{what}");
        (what, clip, fill(reply))
    });
    let cases = [
        ("nothing", String::new(), "empty".to_owned()),
        ("no clip", "hello\n".into(), "line 1: ".into()),
        (
            "no motion",
            good[..good.find("MOTION").expect("there")].into(),
            "MOTION".into(),
        ),
    ];
    for (what, clip, reply) in cases.into_iter().chain(damaged) {
        let (status, detail, field) = refused(&server, &id, &json!({"rig": bar_rig()}), Some(clip)).await;
        assert!(
            detail.starts_with("clip: ") && detail.contains(&reply),
            "{what}: {detail:?} lacks {reply:?}"
        );
        let expected = if status == 413 { (413, "") } else { (400, "clip") };
        assert_eq!((status, field.as_str()), expected, "{what}: {detail}");
    }
    let options = json!({"rig": bar_rig(), "count": 1});
    let answer = post_animation(&server, &id, "*/*", animation_form(&options, Some(good))).await;
    assert_eq!(answer.status(), 200, "the session is as good as before");
}

/// Where the options are changed | to what | the field of the refusal | words of its detail.
const WRONG_RIGS: &str = r#"
/rig/bones/1/joint  | "tail"    | rig.joint           | not a joint of the clip
/rig/bones/1/parent | "high"    | rig.bones           | form a cycle
/rig/bones/1/to     | "nowhere" | rig.bones[1].to     | nowhere
/rig/bones/0/radius | 0         | rig.bones[0].radius | is 0
/rig/version        | 9         | rig.version         | is 9
/rig/joints         | {"bottom": [900, 0, 0], "middle": [900, 0, 2], "top": [900, 0, 4]} | rig | holds nothing
"#;

/// Options, in which RIG stands for the rig of the bar | the field of the refusal | words of its detail.
const WRONG_VALUES: &str = r#"
{}                                   | rig    | is missing
{"rig": RIG, "first": 3}             | first  | is 3, the animation has 3 frames
{"rig": RIG, "refine": 40}           | refine | 0 to 32
{"rig": RIG, "clip": "walk"}         | clip   | is given twice
{"rig": RIG, "bvhSize": 5, "fps": 1} | clip   | is given twice
{"rig": RIG, "output": {"encoding": "DELTA", "changedOnly": 0}} | output.changedOnly | next to nothing
"#;

#[tokio::test(flavor = "multi_thread")]
async fn wrong_rigs_and_values_are_refused_with_their_field() {
    let (server, id) = opened_bar().await;
    let changed = |pointer: &str, value: Value| {
        let mut options = json!({"rig": bar_rig()});
        *options.pointer_mut(pointer).expect("there") = value;
        options
    };
    let rig = bar_rig().to_string();
    let changed = rows(WRONG_RIGS).map(|[pointer, value, field, reply]| {
        let value = serde_json::from_str(value).expect("JSON");
        (changed(pointer, value), field, reply)
    });
    let values = rows(WRONG_VALUES).map(|[options, field, reply]| {
        let options = serde_json::from_str(&options.replace("RIG", &rig)).expect("JSON");
        (options, field, reply)
    });
    for (options, wanted, reply) in changed.chain(values) {
        let (status, detail, field) = refused(&server, &id, &options, Some(bending_clip(3))).await;
        assert_eq!((status, field.as_str()), (422, wanted), "{detail}");
        assert!(detail.contains(reply), "{detail:?} lacks {reply:?}");
    }
    let (status, detail, field) = refused(&server, &id, &json!({"speed": 2}), None).await;
    assert_eq!((status, field.as_str()), (400, "speed"), "{detail}");
    let (status, detail, field) = refused(&server, &id, &json!({"clip": "walk"}), None).await;
    assert_eq!((status, field.as_str()), (422, "clip"), "{detail}");
    let form = animation_form(&json!({}), None).replace("\"options\"", "\"song\"");
    let answer = post_animation(&server, &id, "*/*", form).await;
    assert_eq!(answer.status(), 400);
    let answer = post_animation(&server, &id, "image/png", animation_form(&json!({}), None)).await;
    assert_eq!(answer.status(), 406);
    let answer = post_animation(&server, "0", "*/*", animation_form(&json!({}), None)).await;
    assert_eq!(answer.status(), 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_over_a_limit_is_reported_with_it() {
    let server = Server::with(|sessions, _| {
        sessions.clip_bytes = 4096;
        sessions.clip_joints = 4;
        sessions.animation_frames = 40;
        // The bar has 224 vertices.
        sessions.animation_vertices = 224 * 20;
    })
    .await;
    let id = text(&server.open(bar_obj(16)).await["id"]);
    let (clip, options) = (bending_clip(30), json!({"rig": bar_rig(), "skipFirst": "NO"}));
    let deep = clip.replacen("End Site\n{\nOFFSET 0 0 2\n}", "JOINT a\n{\nOFFSET 0 0 1\nCHANNELS 0\nJOINT b\n{\nOFFSET 0 0 1\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 0 1\n}\n}\n}", 1);
    let long = format!("{clip}{}", " ".repeat(4096));
    let dense = json!({"rig": bar_rig(), "skipFirst": "NO", "fps": 1000});
    for (what, options, clip, reply) in [
        ("bytes", &options, long, "more than the 4096 bytes"),
        ("joints", &options, deep, "at most 4"),
        (
            "frames",
            &dense,
            clip.clone(),
            "the number of frames of the animation is 1451, at most 40",
        ),
        (
            "vertices",
            &options,
            clip.clone(),
            "the number of frames times that of vertices is",
        ),
    ] {
        let (status, detail, _) = refused(&server, &id, options, Some(clip)).await;
        assert_eq!(status, 413, "{what}: {detail}");
        assert!(detail.contains(reply), "{what}: {detail:?} lacks {reply:?}");
    }
    let part = json!({"rig": bar_rig(), "skipFirst": "NO", "first": 9, "count": 3});
    let answer = post_animation(&server, &id, "*/*", animation_form(&part, Some(clip))).await;
    assert_eq!(answer.status(), 200, "a part of it is small enough");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_begins_with_options_and_brings_what_they_announce() {
    let (server, id) = opened_bar().await;
    let mut client = server.grpc().await;
    let announced = |size: u64| {
        Message::Options(pb::AnimateOptions {
            source: Some(Source::BvhSize(size)),
            ..bar_options(&id, "")
        })
    };
    let chunk = |text: &'static str| Message::Chunk(Bytes::from_static(text.as_bytes()));
    let options = Message::Options(bar_options(&id, &bending_clip(9)));
    let unknown = Message::Options(bar_options("nobody", ""));
    for (messages, code, field, reply) in [
        (vec![], Code::InvalidArgument, "options", "the first message"),
        (vec![chunk("x")], Code::InvalidArgument, "options", "the first message"),
        (vec![unknown], Code::NotFound, "", "nobody"),
        (
            vec![announced(9), chunk("1234")],
            Code::InvalidArgument,
            "chunk",
            "4 of the 9 bytes",
        ),
        (
            vec![announced(2), chunk("1234")],
            Code::InvalidArgument,
            "chunk",
            "4 bytes have come, bvhSize says 2",
        ),
        (
            vec![announced(1 << 40)],
            Code::ResourceExhausted,
            "",
            "at most 67108864",
        ),
        (
            vec![announced(4), chunk("1234")],
            Code::InvalidArgument,
            "clip",
            "line 1",
        ),
        (
            vec![options.clone(), options],
            Code::InvalidArgument,
            "message",
            "allowed are ack and cancel",
        ),
    ] {
        let mut animating = Animating::begin_with(&mut client, messages).await;
        animating.half_close();
        let status = loop {
            match animating.next_frame().await {
                Ok(frame) => assert!(frame.is_some(), "{reply}: it came to its end"),
                Err(status) => break status,
            }
        };
        assert_eq!(status.code(), code, "{reply}: {status}");
        assert!(status.message().contains(reply), "{status} lacks {reply:?}");
        let named = status
            .get_details_bad_request()
            .map(|d| d.field_violations[0].field.clone());
        assert_eq!(named.unwrap_or_default(), field, "{status}");
    }
}
