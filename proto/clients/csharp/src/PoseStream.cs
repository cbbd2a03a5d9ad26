using System;
using System.Collections.Generic;
using System.IO;
using System.Net.WebSockets;
using System.Threading;
using System.Threading.Tasks;
using Google.Protobuf;
using Pliant.V1;

namespace Pliant
{
    /// <summary>Poses go up, frames come down; the newest pose wins. Frames are received and acknowledged in the background.</summary>
    public sealed class PoseStream : IDisposable
    {
        /// <summary>Close codes from here on are 4000 and the status of gRPC.</summary>
        const int Failure = 4000;

        readonly ClientWebSocket socket;
        readonly SemaphoreSlim writing = new SemaphoreSlim(1, 1);
        readonly object arriving = new object();
        readonly Dictionary<ulong, TaskCompletionSource<Frame>> waiting = new Dictionary<ulong, TaskCompletionSource<Frame>>();
        long sent;
        Frame newest;
        Frame final;
        Exception end;
        Task receiving;

        PoseStream(ClientWebSocket socket) => this.socket = socket;

        internal static async Task<PoseStream> OpenAsync(Client client, string id, Options options, CancellationToken cancel)
        {
            var socket = new ClientWebSocket();
            socket.Options.AddSubProtocol("pliant.v1");
            if (client.Token != null) socket.Options.SetRequestHeader("Authorization", "Bearer " + client.Token);
            var stream = new PoseStream(socket);
            try
            {
                // http becomes ws, https becomes wss.
                await socket.ConnectAsync(new Uri("ws" + client.Address.Substring(4) + "/v1/sessions/" + id + "/stream"), cancel).ConfigureAwait(false);
                await stream.WriteAsync(new DeformRequest { Options = options }).ConfigureAwait(false);
            }
            catch (WebSocketException problem)
            {
                socket.Dispose();
                throw new PliantException(StatusCode.Unavailable, $"the stream of session {id} does not open: {problem.Message}");
            }
            stream.receiving = Task.Run(stream.ReceiveAsync);
            return stream;
        }

        /// <summary>Sends a pose; its number.</summary>
        public async Task<ulong> SendAsync(IEnumerable<Pose.Types.Entry> entries) => (await SendAsync(entries, false).ConfigureAwait(false)).Seq;

        /// <summary>The newest frame, once; null when none has come since the last call. For a render loop.</summary>
        public Frame Take() => Interlocked.Exchange(ref newest, null);

        /// <summary>Waits for the final frame of this pose or of a newer one.</summary>
        public Task<Frame> WaitAsync(ulong seq)
        {
            lock (arriving)
            {
                if (final != null && final.Seq >= seq) return Task.FromResult(final);
                if (end != null) return Task.FromException<Frame>(end);
                if (!waiting.TryGetValue(seq, out var source))
                    waiting[seq] = source = new TaskCompletionSource<Frame>(TaskCreationOptions.RunContinuationsAsynchronously);
                return source.Task;
            }
        }

        /// <summary>Records a pose, one step for undo, and waits for its frame, which has <c>Quality</c>.</summary>
        public async Task<Frame> CommitAsync(IEnumerable<Pose.Types.Entry> entries)
        {
            var pose = await SendAsync(entries, true).ConfigureAwait(false);
            return await pose.Answer.ConfigureAwait(false);
        }

        /// <summary>Ends the stream.</summary>
        public async Task CloseAsync()
        {
            if (socket.State == WebSocketState.Open)
                await socket.CloseOutputAsync(WebSocketCloseStatus.NormalClosure, "", CancellationToken.None).ConfigureAwait(false);
            await receiving.ConfigureAwait(false);
            socket.Dispose();
        }

        public void Dispose() => socket.Dispose();

        async Task<(ulong Seq, Task<Frame> Answer)> SendAsync(IEnumerable<Pose.Types.Entry> entries, bool isCommit)
        {
            var seq = (ulong)Interlocked.Increment(ref sent);
            var pose = new Pose { Seq = seq, Commit = isCommit };
            pose.Handles.Add(entries);
            // Asked for before it is sent, so that a failure of this pose finds who waits.
            var answer = isCommit ? WaitAsync(seq) : null;
            try
            {
                await WriteAsync(new DeformRequest { Pose = pose }).ConfigureAwait(false);
            }
            catch (Exception problem) when (problem is WebSocketException || problem is ObjectDisposedException || problem is InvalidOperationException)
            {
                lock (arriving) throw end ?? new PliantException(StatusCode.Unavailable, "the stream is closed");
            }
            return (seq, answer);
        }

        async Task WriteAsync(DeformRequest request)
        {
            var bytes = new ArraySegment<byte>(request.ToByteArray());
            await writing.WaitAsync().ConfigureAwait(false);
            try
            {
                await socket.SendAsync(bytes, WebSocketMessageType.Binary, true, CancellationToken.None).ConfigureAwait(false);
            }
            finally
            {
                writing.Release();
            }
        }

        async Task ReceiveAsync()
        {
            Exception reason;
            try
            {
                var assembler = new FrameAssembler();
                byte[] message;
                while ((message = await ReadAsync().ConfigureAwait(false)) != null)
                {
                    var response = DeformResponse.Parser.ParseFrom(message);
                    if (response.Error != null) Fail(response.Error);
                    if (response.Frame == null) continue;
                    var frame = assembler.Add(response.Frame);
                    if (frame == null) continue;
                    Arrive(frame);
                    if (socket.State == WebSocketState.Open)
                        await WriteAsync(new DeformRequest { Ack = new Ack { Seq = frame.Seq } }).ConfigureAwait(false);
                }
                var code = (int)(socket.CloseStatus ?? WebSocketCloseStatus.NormalClosure);
                var status = code > Failure ? (StatusCode)(code - Failure) : code == 1000 ? StatusCode.Cancelled : StatusCode.Unavailable;
                reason = new PliantException(status, string.IsNullOrEmpty(socket.CloseStatusDescription) ? "the stream is closed" : socket.CloseStatusDescription);
            }
            catch (PliantException problem)
            {
                reason = problem;
            }
            catch (Exception problem)
            {
                reason = new PliantException(StatusCode.Unavailable, $"the stream broke: {problem.Message}");
            }
            lock (arriving)
            {
                end = end ?? reason;
                foreach (var source in waiting.Values) source.TrySetException(end);
                waiting.Clear();
            }
        }

        /// <summary>The next message; null when the server closes the stream.</summary>
        async Task<byte[]> ReadAsync()
        {
            var whole = new MemoryStream();
            var buffer = new ArraySegment<byte>(new byte[64 << 10]);
            while (true)
            {
                var read = await socket.ReceiveAsync(buffer, CancellationToken.None).ConfigureAwait(false);
                if (read.MessageType == WebSocketMessageType.Close) return null;
                whole.Write(buffer.Array, 0, read.Count);
                if (read.EndOfMessage) return whole.ToArray();
            }
        }

        void Arrive(Frame frame)
        {
            Volatile.Write(ref newest, frame);
            if (!frame.IsFinal) return;
            lock (arriving)
            {
                final = frame;
                foreach (var seq in new List<ulong>(waiting.Keys))
                {
                    if (seq > frame.Seq) continue;
                    waiting[seq].TrySetResult(frame);
                    waiting.Remove(seq);
                }
            }
        }

        void Fail(Error error)
        {
            var problem = new PliantException((StatusCode)error.Code, error.Message);
            lock (arriving)
            {
                if (error.Seq == 0) end = problem;
                if (!waiting.TryGetValue(error.Seq, out var source)) return;
                source.TrySetException(problem);
                waiting.Remove(error.Seq);
            }
        }
    }
}
