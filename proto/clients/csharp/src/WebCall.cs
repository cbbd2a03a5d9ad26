using System;
using System.Collections.Generic;
using System.Text;
using Google.Protobuf;

namespace Pliant
{
    /// <summary>The bytes of gRPC-Web: each message has a flag and its length before it, the last one holds the status.</summary>
    static class WebCall
    {
        const int Head = 5;
        const byte Status = 0x80;

        internal static byte[] Request(IMessage message)
        {
            var bytes = message.ToByteArray();
            var framed = new byte[Head + bytes.Length];
            for (var k = 0; k < 4; k++) framed[1 + k] = (byte)(bytes.Length >> (24 - 8 * k));
            bytes.CopyTo(framed, Head);
            return framed;
        }

        internal static List<T> Answers<T>(byte[] body, MessageParser<T> parser) where T : IMessage<T>
        {
            var answers = new List<T>();
            var isComplete = false;
            for (var at = 0; at < body.Length;)
            {
                if (body.Length - at < Head) throw Broken();
                var length = (long)body[at + 1] << 24 | (long)body[at + 2] << 16 | (long)body[at + 3] << 8 | body[at + 4];
                if (length > body.Length - at - Head) throw Broken();
                var flag = body[at];
                at += Head;
                if ((flag & Status) == 0)
                {
                    answers.Add(parser.ParseFrom(body, at, (int)length));
                }
                else
                {
                    var fields = new Dictionary<string, string>(StringComparer.OrdinalIgnoreCase);
                    foreach (var line in Encoding.ASCII.GetString(body, at, (int)length).Split(new[] { "\r\n" }, StringSplitOptions.RemoveEmptyEntries))
                    {
                        var colon = line.IndexOf(':');
                        if (colon > 0) fields[line.Substring(0, colon)] = line.Substring(colon + 1).Trim();
                    }
                    Check(name => fields.TryGetValue(name, out var value) ? value : null);
                    isComplete = true;
                }
                at += (int)length;
            }
            return isComplete ? answers : throw Broken();
        }

        /// <summary>Throws what headers or trailers say of a failure.</summary>
        internal static void Check(Func<string, string> field)
        {
            var status = field("grpc-status");
            if (status == null || status == "0") return;
            var code = int.TryParse(status, out var number) ? (StatusCode)number : StatusCode.Unknown;
            throw new PliantException(code, Uri.UnescapeDataString(field("grpc-message") ?? "the call failed without a reason"));
        }

        static PliantException Broken() => new PliantException(StatusCode.Unavailable, "the answer is not complete");
    }
}
