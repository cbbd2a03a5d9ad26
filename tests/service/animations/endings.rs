//! What an animation leaves alone, what holds it up, and how it ends.

use super::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};
use tonic::Code;

/// Far more frames than a test waits for.
fn endless(options: pb::AnimateOptions) -> pb::AnimateOptions {
    pb::AnimateOptions {
        fps: 10_000.0,
        ..options
    }
}

/// Waits until no animation is under way.
async fn all_ended(server: &Server) {
    eventually("the end of the animation", async || {
        server.metric("pliant_animations").await == 0.0
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_that_are_not_acknowledged_hold_it_up_and_none_is_left_out() {
    let (server, id) = opened_bar().await;
    let mut client = server.grpc().await;
    let options = pb::AnimateOptions {
        window: 3,
        ..bar_options(&id, &bending_clip(20))
    };
    let mut animating = Animating::begin(&mut client, options).await;
    let mut seqs = Vec::new();
    for _ in 0..3 {
        seqs.push(animating.frame().await.seq);
    }
    {
        let next = animating.next_frame();
        tokio::pin!(next);
        for _ in 0..20 {
            assert!(futures::poll!(next.as_mut()).is_pending(), "three are on their way");
            client
                .get_session(pb::SessionRequest { session_id: id.clone() })
                .await
                .expect("the session answers");
        }
    }
    animating.acknowledge(2);
    for _ in 0..2 {
        seqs.push(animating.frame().await.seq);
    }
    animating.half_close();
    while let Some(frame) = animating.next_frame().await.expect("no failure") {
        seqs.push(frame.seq);
    }
    assert_eq!(seqs, (1..=20).collect::<Vec<u64>>());
}

#[tokio::test(flavor = "multi_thread")]
async fn others_have_their_turn_between_frames_and_the_session_stays_as_it_is() {
    let server = Server::with(|sessions, _| {
        sessions.compute_threads = 1;
        sessions.compute_slots = 1;
    })
    .await;
    let (mine, other) = (server.bar_session().await, server.bar_session().await);
    let mut client = server.grpc().await;
    let solve = |id: &str| turn_request(id, 1, 0.4);
    client.solve(solve(&mine)).await.expect("solved");
    let named = || pb::SessionRequest {
        session_id: mine.clone(),
    };
    let positions = async || {
        let url = server.url(&path(&mine, "/positions"));
        http().get(url).answer().await.bytes().await.expect("a body")
    };
    let reply = |session: pb::Session| (session.revision, session.handles);
    let before = reply(client.get_session(named()).await.expect("there").into_inner());
    let history = client.history(named()).await.expect("there").into_inner();
    let shape = positions().await;

    let mut animating = Animating::begin(&mut client, endless(bar_options(&mine, &bending_clip(200)))).await;
    animating.half_close();
    let count = animating.frame().await.reply.count as usize;
    let seen = Arc::new(AtomicUsize::new(1));
    let counted = Arc::clone(&seen);
    let reading = tokio::spawn(async move {
        while let Ok(Some(_)) = animating.next_frame().await {
            counted.fetch_add(1, SeqCst);
        }
    });
    // The reader never stops, so the only slot is always asked for by the animation as well.
    for _ in 0..3 {
        let solved = within("a solve beside an animation", client.solve(solve(&other))).await;
        solved.expect("solved");
    }
    assert!(seen.load(SeqCst) < count, "the animation was still under way");
    assert_eq!(
        reply(client.get_session(named()).await.expect("there").into_inner()),
        before
    );
    assert_eq!(client.history(named()).await.expect("there").into_inner(), history);
    assert_eq!(positions().await, shape);
    let again = within("a solve of the session itself", client.solve(solve(&mine))).await;
    again.expect("the session works on");
    reading.abort();
    all_ended(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn cancelling_and_leaving_give_its_place_back() {
    let server = Server::with(|sessions, _| sessions.animations = 1).await;
    let id = text(&server.open(bar_obj(16)).await["id"]);
    let mut client = server.grpc().await;
    let options = endless(bar_options(&id, &bending_clip(200)));

    let mut animating = Animating::begin(&mut client, options.clone()).await;
    let first = animating.frame().await;
    let mut second = Animating::begin(&mut client, options.clone()).await;
    let refused = second.next_frame().await.expect_err("one is under way");
    assert_eq!(refused.code(), Code::ResourceExhausted);
    assert!(refused.message().contains("1 animations are under way"), "{refused}");
    animating.acknowledge(first.seq);
    animating.send(Message::Cancel(pb::Cancel {}));
    let ended = loop {
        match animating.next_frame().await {
            Ok(Some(frame)) => animating.acknowledge(frame.seq),
            Ok(None) => panic!("it came to its end"),
            Err(status) => break status,
        }
    };
    assert_eq!(ended.code(), Code::Cancelled);
    all_ended(&server).await;

    let mut animating = Animating::begin(&mut client, options.clone()).await;
    animating.frame().await;
    drop(animating);
    all_ended(&server).await;
    let options = pb::AnimateOptions { count: 2, ..options };
    assert_eq!(animated(&server, options).await.len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn deleting_the_session_ends_it_and_says_why() {
    let (server, id) = opened_bar().await;
    let mut client = server.grpc().await;
    let mut animating = Animating::begin(&mut client, endless(bar_options(&id, &bending_clip(200)))).await;
    animating.half_close();
    animating.frame().await;
    let named = pb::SessionRequest { session_id: id };
    client.delete_session(named).await.expect("deleted");
    let ended = loop {
        match animating.next_frame().await {
            Ok(Some(_)) => {}
            Ok(None) => panic!("it came to its end"),
            Err(status) => break status,
        }
    };
    assert_eq!(ended.code(), Code::NotFound);
    assert!(ended.message().contains("was deleted"), "{ended}");
    all_ended(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edit_meanwhile_changes_the_next_animation_only() {
    let (server, id) = Server::start_with_bar().await;
    let mut client = server.grpc().await;
    let options = bar_options(&id, &bending_clip(12));
    let wanted = animated(&server, options.clone()).await;
    let mut animating = Animating::begin(&mut client, options.clone()).await;
    let first = animating.frame().await;
    let edit = json!({"sessionId": id, "subdivide": {"region": {"halfSpace": {"normal": [0, 0, 1], "offset": 2}}}});
    let edit: pb::EditRequest = pliant::wire::json::from_json(edit.to_string().as_bytes()).expect("an edit");
    client.edit(edit).await.expect("edited");
    animating.acknowledge(first.seq);
    let mut seen = vec![first];
    seen.extend(animating.all_frames().await);
    assert_eq!(seen, wanted);
    let after = animated(&server, options).await;
    assert!(after[0].data.len() > wanted[0].data.len(), "it has more vertices now");
    let form = animation_form(&json!({"rig": bar_rig()}), Some(bending_clip(3)));
    let refused = post_animation(&server, &id, "model/gltf-binary", form).await;
    assert_eq!(refused.status(), 409);
    let said = refused.text().await.expect("a problem");
    assert!(said.contains("edits have changed the model"), "{said}");
}
