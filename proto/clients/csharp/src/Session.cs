using System.Collections.Generic;
using System.IO;
using System.Threading;
using System.Threading.Tasks;
using Pliant.V1;

namespace Pliant
{
    /// <summary>One model on the server and the log of its changes.</summary>
    public sealed class Session
    {
        readonly Client client;

        /// <summary>The session's id, by which another client finds it.</summary>
        public string Id { get; }

        internal Session(Client client, string id)
        {
            this.client = client;
            Id = id;
        }

        /// <summary>Model, handles, revision and warnings as they are now.</summary>
        public Task<V1.Session> InfoAsync(CancellationToken cancel = default) => OnSessionAsync("GetSession", cancel);

        /// <summary>Replaces all handles.</summary>
        public Task<V1.Session> SetHandlesAsync(params Handle[] handles)
        {
            var request = new SetHandlesRequest();
            request.Handles.Add(handles);
            return SetHandlesAsync(request);
        }

        /// <summary>As above, with symmetry, a region of interest or stiff parts. The session's id is filled in.</summary>
        public Task<V1.Session> SetHandlesAsync(SetHandlesRequest request, CancellationToken cancel = default)
        {
            request.SessionId = Id;
            return client.CallAsync("SetHandles", request, V1.Session.Parser, cancel);
        }

        /// <summary>Solves and records one pose. Handles without an entry keep theirs.</summary>
        public async Task<Frame> SolveAsync(IEnumerable<Pose.Types.Entry> entries, Options options = null, CancellationToken cancel = default)
        {
            FrameAssembler.Check(options);
            var request = new SolveRequest { SessionId = Id, Pose = new Pose(), Options = options };
            request.Pose.Handles.Add(entries);
            Frame solved = null;
            var assembler = new FrameAssembler();
            foreach (var part in await client.CallManyAsync("Solve", request, V1.Frame.Parser, cancel).ConfigureAwait(false))
                solved = assembler.Add(part) ?? solved;
            return solved ?? throw new PliantException(StatusCode.Internal, "the server sent no frame");
        }

        /// <summary>Changes the topology: cut, remesh, fill, … The session's id is filled in.</summary>
        public Task<EditResult> EditAsync(EditRequest request, CancellationToken cancel = default)
        {
            request.SessionId = Id;
            return client.CallAsync("Edit", request, EditResult.Parser, cancel);
        }

        public Task<V1.Session> UndoAsync(CancellationToken cancel = default) => OnSessionAsync("Undo", cancel);

        public Task<V1.Session> RedoAsync(CancellationToken cancel = default) => OnSessionAsync("Redo", cancel);

        /// <summary>The model in its current shape, as bytes of a format: glb, obj, ply, …</summary>
        public async Task<byte[]> ExportAsync(string format, CancellationToken cancel = default)
        {
            var request = new ExportRequest { SessionId = Id, Format = format };
            var model = new MemoryStream();
            foreach (var chunk in await client.CallManyAsync("Export", request, Chunk.Parser, cancel).ConfigureAwait(false))
                chunk.Data.WriteTo(model);
            return model.ToArray();
        }

        /// <summary>Opens a stream of poses.</summary>
        public Task<PoseStream> StreamAsync(Options options = null, CancellationToken cancel = default)
        {
            FrameAssembler.Check(options);
            return PoseStream.OpenAsync(client, Id, options ?? new Options(), cancel);
        }

        /// <summary>Deletes the session. Without it the session expires when it is unused.</summary>
        public Task CloseAsync(CancellationToken cancel = default) =>
            client.CallAsync("DeleteSession", new SessionRequest { SessionId = Id }, DeleteSessionResponse.Parser, cancel);

        Task<V1.Session> OnSessionAsync(string method, CancellationToken cancel) =>
            client.CallAsync(method, new SessionRequest { SessionId = Id }, V1.Session.Parser, cancel);
    }
}
