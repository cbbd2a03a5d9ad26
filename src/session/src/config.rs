//! What a server lets its sessions use.

use crate::capacity::call_queue::MIN_TTL;
use crate::error::Error;
use crate::quota::tenant_quota::{TenantQuota, TenantQuotas};
use pliant_core::engine;
use pliant_core::engine::AnimationLimits;
use pliant_motion::bvh::ClipLimits;
use pliant_wire::StreamLimits;
use std::time::Duration;

/// The longest time to live that may be allowed.
const LONGEST_TTL: Duration = Duration::from_secs(366 * 24 * 3600);

/// The limits that sessions keep to. [`SessionConfig::validate`] says which values make sense; 0 never means "no limit".
#[derive(Debug, Clone, PartialEq)]
pub struct SessionConfig {
    /// Bytes of one upload, companions included.
    pub upload_bytes: u64,
    /// Render vertices of one model.
    pub vertices: u64,
    /// Triangles of one model.
    pub triangles: u64,
    /// Sessions held at a time.
    pub sessions: usize,
    /// Bytes that all sessions together may hold.
    pub memory_bytes: u64,
    /// Share of `memory_bytes` above which the server reports that it takes no new work.
    pub high_water: f64,
    /// Handles of one session.
    pub handles: usize,
    /// Bytes of one control message; enforced by the transports, and bounds what a stream holds of waiting poses.
    pub message_bytes: u64,
    /// Largest window of unacknowledged frames.
    pub window: u32,
    /// Bytes of the data of one frame part.
    pub part_bytes: usize,
    /// Time to live of a session that names none.
    pub default_ttl: Duration,
    /// Longest time to live that a session may ask for.
    pub max_ttl: Duration,
    /// How long an unused session that is kept in a store stays in memory.
    pub idle: Duration,
    /// Commits that can be undone.
    pub history: usize,
    /// Bytes of old shapes that one session keeps, so that going back costs no solve.
    pub snapshot_bytes: u64,
    /// Longest solve.
    pub solve: Duration,
    /// Longest build of a session, or of its handles.
    pub build: Duration,
    /// Streams open on one session at a time.
    pub streams: usize,
    /// Animations under way at a time.
    pub animations: usize,
    /// Bytes of one clip.
    pub clip_bytes: u64,
    /// Joints of one clip.
    pub clip_joints: usize,
    /// Frames of one animation.
    pub animation_frames: usize,
    /// Frames that are wanted of one animation, times the vertices of its model.
    pub animation_vertices: u64,
    /// Commits waiting on one stream.
    pub stream_commits: usize,
    /// Calls waiting on one session.
    pub session_queue: usize,
    /// Compute threads; 0 = one for each core.
    pub compute_threads: usize,
    /// Pieces of work computed at a time; 0 = as many as there are compute threads. For every four, one more may be a drag.
    pub compute_slots: usize,
    /// Pieces of work that may wait for a compute slot.
    pub compute_queue: usize,
    /// Longest wait for a compute slot.
    pub compute_wait: Duration,
    /// How long the answer to an idempotency key is kept.
    pub idempotency_age: Duration,
    /// Idempotency keys kept for one tenant.
    pub idempotency_keys: usize,
    /// What each tenant may use.
    pub quotas: TenantQuotas,
    /// What starts a process for decoders in C and C++. `None`: they run in this process.
    pub apart: Option<pliant_asset::ParserStarter>,
    /// How long open work may go on once the server is asked to stop; enforced by the server.
    pub drain: Duration,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            upload_bytes: 1 << 30,
            vertices: 20_000_000,
            triangles: 40_000_000,
            sessions: 64,
            memory_bytes: 8 << 30,
            high_water: 0.9,
            handles: 16_384,
            message_bytes: 4 << 20,
            window: 8,
            part_bytes: 1 << 20,
            default_ttl: Duration::from_secs(15 * 60),
            max_ttl: Duration::from_secs(24 * 3600),
            idle: Duration::from_secs(300),
            history: 100,
            snapshot_bytes: 256 << 20,
            solve: Duration::from_secs(60),
            build: Duration::from_secs(600),
            streams: 4,
            animations: 8,
            clip_bytes: 64 << 20,
            clip_joints: 4096,
            animation_frames: 100_000,
            animation_vertices: 10_000_000_000,
            stream_commits: 16,
            session_queue: 64,
            compute_threads: 0,
            compute_slots: 0,
            compute_queue: 256,
            compute_wait: Duration::from_secs(30),
            idempotency_age: Duration::from_secs(600),
            idempotency_keys: 1000,
            quotas: TenantQuotas::default(),
            apart: None,
            drain: Duration::from_secs(10),
        }
    }
}

impl SessionConfig {
    /// Checks that every value makes sense.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` with the key and what is allowed.
    pub fn validate(&self) -> Result<(), Error> {
        let (vertex_numbers, any) = (u128::from(u32::MAX), u128::MAX);
        let ranges: [(&str, u128, u128, u128); 23] = [
            ("upload_bytes", self.upload_bytes.into(), 1, any),
            ("vertices", self.vertices.into(), 3, vertex_numbers),
            ("triangles", self.triangles.into(), 1, any),
            ("sessions", self.sessions as u128, 1, 1_000_000),
            ("memory_bytes", self.memory_bytes.into(), 1 << 20, any),
            ("handles", self.handles as u128, 1, vertex_numbers),
            ("message_bytes", self.message_bytes.into(), 1024, any),
            ("window", self.window.into(), 2, 64),
            ("part_bytes", self.part_bytes as u128, 1024, any),
            ("history", self.history as u128, 1, 100_000),
            ("solve_ms", self.solve.as_millis(), 1, any),
            ("build_ms", self.build.as_millis(), 1, any),
            ("streams", self.streams as u128, 1, 1024),
            ("animations", self.animations as u128, 1, 1024),
            ("clip_bytes", self.clip_bytes.into(), 1024, any),
            ("clip_joints", self.clip_joints as u128, 1, any),
            ("animation_frames", self.animation_frames as u128, 1, any),
            ("animation_vertices", self.animation_vertices.into(), 1, any),
            ("stream_commits", self.stream_commits as u128, 1, any),
            ("session_queue", self.session_queue as u128, 1, any),
            ("compute_queue", self.compute_queue as u128, 1, any),
            ("idempotency_keys", self.idempotency_keys as u128, 1, any),
            ("idle", self.idle.as_millis(), 100, any),
        ];
        for (field, seen, least, most) in ranges {
            if seen < least {
                return Err(Error::invalid(field, format!("is {seen}, at least {least} is allowed")));
            }
            if seen > most {
                return Err(Error::invalid(field, format!("is {seen}, at most {most} is allowed")));
            }
        }
        let spans = |field: &str, seen: Duration, [least, most]: [Duration; 2]| {
            if seen < least || seen > most {
                let [seen, least, most] = [seen, least, most].map(humantime::format_duration);
                return Err(Error::invalid(
                    field,
                    format!("is {seen}, {least} to {most} is allowed"),
                ));
            }
            Ok(())
        };
        spans("max_ttl", self.max_ttl, [MIN_TTL, LONGEST_TTL])?;
        spans("ttl", self.default_ttl, [MIN_TTL, self.max_ttl])?;
        self.quotas.default.validate()?;
        self.quotas.named.values().try_for_each(TenantQuota::validate)?;
        if !(self.high_water > 0.0 && self.high_water <= 1.0) {
            return Err(Error::invalid(
                "high_water",
                format!("is {}, above 0 and at most 1 is allowed", self.high_water),
            ));
        }
        Ok(())
    }

    /// The limits of one deformer that may hold `memory_bytes`.
    pub(super) fn deformer_limits(&self, memory_bytes: u64) -> engine::DeformerLimits {
        engine::DeformerLimits {
            model: pliant_asset::Limits {
                vertices: self.vertices,
                triangles: self.triangles,
                decoded_bytes: memory_bytes,
                document_bytes: memory_bytes,
                points_and_lines: true,
                cage_triangles: pliant_asset::Limits::CAGE_TRIANGLES,
                apart: self.apart,
            },
            memory_bytes,
            graph_bytes: None,
            handles: self.handles,
        }
    }

    /// How large an animation may be.
    pub fn animation_limits(&self) -> AnimationLimits {
        AnimationLimits {
            clip: ClipLimits {
                bytes: self.clip_bytes,
                joints: self.clip_joints,
                ..Default::default()
            },
            frames: self.animation_frames,
            vertices: self.animation_vertices,
        }
    }

    /// How large the requests of a deform stream may be.
    pub fn stream_limits(&self) -> StreamLimits {
        StreamLimits {
            window: self.window,
            pose_entries: self.handles,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_nonsense_is_named() {
        SessionConfig::default().validate().expect("the defaults hold together");
        let refused = |config: SessionConfig| config.validate().expect_err("refused").field;
        assert_eq!(
            refused(SessionConfig {
                sessions: 0,
                ..SessionConfig::default()
            })
            .as_deref(),
            Some("sessions")
        );
        assert_eq!(
            refused(SessionConfig {
                high_water: f64::NAN,
                ..SessionConfig::default()
            })
            .as_deref(),
            Some("high_water")
        );
        let short = SessionConfig {
            max_ttl: Duration::from_secs(60),
            ..SessionConfig::default()
        };
        assert_eq!(refused(short).as_deref(), Some("ttl"));
    }
}
