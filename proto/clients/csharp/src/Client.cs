using System;
using System.Collections.Generic;
using System.IO;
using System.Net.Http;
using System.Net.Http.Headers;
using System.Threading;
using System.Threading.Tasks;
using Google.Protobuf;
using Pliant.V1;

namespace Pliant
{
    /// <summary>A connection to a server. It needs no gRPC library and no HTTP/2: calls are gRPC-Web, streams are WebSockets.</summary>
    public sealed class Client : IDisposable
    {
        readonly HttpClient http;

        /// <summary>Where the server is, without a slash at the end.</summary>
        internal string Address { get; }

        internal string Token { get; }

        /// <param name="address">http://HOST:PORT or https://HOST:PORT</param>
        /// <param name="token">Access token; null without authentication.</param>
        public Client(string address, string token = null)
        {
            if (!Uri.TryCreate(address, UriKind.Absolute, out var uri) || (uri.Scheme != "http" && uri.Scheme != "https"))
                throw new PliantException(StatusCode.InvalidArgument, $"\"{address}\" is not an address such as http://127.0.0.1:7411");
            Address = address.TrimEnd('/');
            Token = token;
            http = new HttpClient { Timeout = Timeout.InfiniteTimeSpan };
            if (token != null) http.DefaultRequestHeaders.Authorization = new AuthenticationHeaderValue("Bearer", token);
        }

        /// <summary>Uploads a model. Its format is the file's extension unless <c>options.Format</c> names one.</summary>
        public Task<Session> OpenAsync(string file, CreateOptions options = null, CancellationToken cancel = default)
        {
            options = options?.Clone() ?? new CreateOptions();
            if (options.Format == "") options.Format = Path.GetExtension(file).TrimStart('.');
            if (options.Label == "") options.Label = Path.GetFileName(file);
            return OpenAsync(File.ReadAllBytes(file), options, null, cancel);
        }

        /// <summary>Uploads a model from memory, with files that it refers to, by their relative URIs.</summary>
        public async Task<Session> OpenAsync(
            byte[] model, CreateOptions options, IDictionary<string, byte[]> companions = null, CancellationToken cancel = default)
        {
            using (var form = new MultipartFormDataContent())
            {
                form.Add(new StringContent(JsonFormatter.Default.Format(options)), "options");
                form.Add(new ByteArrayContent(model), "model", "model");
                foreach (var companion in companions ?? new Dictionary<string, byte[]>())
                    form.Add(new ByteArrayContent(companion.Value), "companion", companion.Key);
                using (var answer = await SendAsync(HttpMethod.Post, "/v1/sessions", form, cancel).ConfigureAwait(false))
                {
                    var location = answer.Headers.Location?.OriginalString ?? "";
                    return new Session(this, location.Substring(location.LastIndexOf('/') + 1));
                }
            }
        }

        /// <summary>The built-in creature, as the bytes of a GLB.</summary>
        public async Task<byte[]> SampleAsync(CancellationToken cancel = default)
        {
            using (var answer = await SendAsync(HttpMethod.Get, "/v1/sample.glb", null, cancel).ConfigureAwait(false))
                return await answer.Content.ReadAsByteArrayAsync().ConfigureAwait(false);
        }

        /// <summary>A session that is there.</summary>
        public Session Session(string id) => new Session(this, id);

        /// <summary>What the server allows.</summary>
        public Task<Limits> LimitsAsync(CancellationToken cancel = default) =>
            CallAsync("GetLimits", new GetLimitsRequest(), Limits.Parser, cancel);

        public void Dispose() => http.Dispose();

        /// <summary>A call with one answer.</summary>
        internal async Task<T> CallAsync<T>(string method, IMessage request, MessageParser<T> parser, CancellationToken cancel)
            where T : IMessage<T>
        {
            var answers = await CallManyAsync(method, request, parser, cancel).ConfigureAwait(false);
            return answers.Count == 1
                ? answers[0]
                : throw new PliantException(StatusCode.Internal, $"{method}: {answers.Count} answers came instead of one");
        }

        /// <summary>A call whose answer comes in parts.</summary>
        internal async Task<List<T>> CallManyAsync<T>(string method, IMessage request, MessageParser<T> parser, CancellationToken cancel)
            where T : IMessage<T>
        {
            var content = new ByteArrayContent(WebCall.Request(request));
            content.Headers.ContentType = new MediaTypeHeaderValue("application/grpc-web+proto");
            using (var answer = await SendAsync(HttpMethod.Post, "/pliant.v1.Deformer/" + method, content, cancel).ConfigureAwait(false))
            {
                WebCall.Check(name => answer.Headers.TryGetValues(name, out var values) ? string.Join(",", values) : null);
                var body = await answer.Content.ReadAsByteArrayAsync().ConfigureAwait(false);
                return WebCall.Answers(body, parser);
            }
        }

        async Task<HttpResponseMessage> SendAsync(HttpMethod method, string path, HttpContent content, CancellationToken cancel)
        {
            HttpResponseMessage answer;
            try
            {
                var request = new HttpRequestMessage(method, Address + path) { Content = content };
                answer = await http.SendAsync(request, cancel).ConfigureAwait(false);
            }
            catch (HttpRequestException problem)
            {
                throw new PliantException(StatusCode.Unavailable, $"{Address} does not answer: {(problem.InnerException ?? problem).Message}");
            }
            if (answer.IsSuccessStatusCode) return answer;
            using (answer)
            {
                var text = await answer.Content.ReadAsStringAsync().ConfigureAwait(false);
                throw PliantException.OfProblem((int)answer.StatusCode, text);
            }
        }
    }
}
