//! Downloads: entity tags, ranges, conditional requests.

use super::post;
use crate::support::server::*;
use reqwest::header;
use serde_json::json;

#[tokio::test(flavor = "multi_thread")]
async fn downloads_honour_tags_and_ranges() {
    let server = Server::start().await;
    let model = bar_obj(24);
    let id = text(&server.open(model.clone()).await["id"]);
    let url = server.url(&format!("/v1/sessions/{id}/model"));
    let whole = http().get(&url).answer().await;
    assert_eq!(whole.status(), 200);
    assert_eq!(whole.headers()[header::ACCEPT_RANGES], "bytes");
    assert_eq!(
        whole.headers()[header::CONTENT_DISPOSITION].to_str().unwrap(),
        format!("attachment; filename=\"{id}.obj\"")
    );
    let etag = whole.headers()[header::ETAG].to_str().unwrap().to_owned();
    assert!(etag.starts_with('"'), "a strong tag: {etag}");
    let bytes = whole.bytes().await.unwrap();
    assert_eq!(bytes, model.as_bytes(), "at rest the model comes back byte for byte");

    let part = http().get(&url).header("range", "bytes=10-19").answer().await;
    assert_eq!(part.status(), 206);
    assert_eq!(
        part.headers()[header::CONTENT_RANGE].to_str().unwrap(),
        format!("bytes 10-19/{}", bytes.len())
    );
    assert_eq!(part.bytes().await.unwrap(), bytes.slice(10..20));
    let tail = http()
        .get(&url)
        .header("range", "bytes=-5")
        .header("if-range", &etag)
        .answer()
        .await;
    assert_eq!(
        (tail.status().as_u16(), tail.bytes().await.unwrap()),
        (206, bytes.slice(bytes.len() - 5..))
    );
    let stale = http()
        .get(&url)
        .header("range", "bytes=0-4")
        .header("if-range", "\"old\"")
        .answer()
        .await;
    assert_eq!(stale.status(), 200);
    let past = http()
        .get(&url)
        .header("range", format!("bytes={}-", bytes.len()))
        .answer()
        .await;
    assert_eq!(past.status(), 416);
    assert_eq!(
        past.headers()[header::CONTENT_RANGE].to_str().unwrap(),
        format!("bytes */{}", bytes.len())
    );

    let known = http().get(&url).header("if-none-match", &etag).answer().await;
    assert_eq!(
        (known.status().as_u16(), known.headers()[header::ETAG].to_str().unwrap()),
        (304, etag.as_str())
    );
    let head = http().head(&url).answer().await;
    assert_eq!(
        (
            head.status().as_u16(),
            head.headers()[header::CONTENT_LENGTH].to_str().unwrap()
        ),
        (200, bytes.len().to_string().as_str())
    );
    let ply = http().get(format!("{url}?format=ply")).answer().await;
    assert_ne!(ply.headers()[header::ETAG].to_str().unwrap(), etag);

    // A changed shape is another thing.
    let handles = server
        .put(&format!("/v1/sessions/{id}/handles"))
        .json(&json!({"handles": ends()}))
        .answer()
        .await;
    assert_eq!(handles.status(), 200);
    assert_eq!(
        post(&server, &format!("/v1/sessions/{id}/solve"), turn_json(0.3))
            .await
            .status(),
        200
    );
    let changed = http().get(&url).header("if-none-match", &etag).answer().await;
    assert_eq!(changed.status(), 200);
    assert_ne!(changed.bytes().await.unwrap(), bytes);
}
